"""The same work on many machines, or on several processors of one: Dask does the sending.

Takes go to workers one by one (`each`); models learn from frames that lie in blocks on the workers
(`frames_of`, and `fit` of any model). `cluster` says where: an address is all that it needs.
"""

from facelab.numeric.engine import Killed
from facelab.scale.frames import Frames, frames_of
from facelab.scale.machines import cluster
from facelab.scale.spread import Lost, each

__all__ = ["Frames", "Killed", "Lost", "cluster", "each", "frames_of"]
