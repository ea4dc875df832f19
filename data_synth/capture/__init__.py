"""What a capture system sees of the four actors: markers in motion, with its faults.

A capture is a folder per actor: one C3D file for each take, and beside them the truth from which
they were made: weights, head pose, marker sites, faults and seed. Dense surfaces are rebuilt from
it on demand; all of them would be gigabytes.

```
sites.py      where the markers are glued
faults.py     what the cameras make of them: noise, occlusion, swapped names, ghosts
recording.py  the takes of an actor, recorded into files
reading.py    `Capture`: the takes and the truth behind them, from the files
store.py      `make_capture`, `open_capture`: whole folders, and the cache of them
```
"""

from data_synth.capture.reading import Capture
from data_synth.capture.recording import SIZES
from data_synth.capture.store import make_capture, open_capture

__all__ = ["SIZES", "Capture", "make_capture", "open_capture"]
