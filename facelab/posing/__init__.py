"""Poses by hand: pins, drags, sliders, clips (Tena et al. 2011, sections 3.2 and 6)."""

from facelab.models.region import BETA
from facelab.posing.bounded import BoundedPull
from facelab.posing.clips import Clip, interpolate, interpolate_gaze
from facelab.posing.log import replay
from facelab.posing.ranges import GAMMA
from facelab.posing.sculpt import Sculpt
from facelab.posing.session import PosingSession
from facelab.posing.solver import PoseSolver
from facelab.posing.state import PoseState

__all__ = [
    "BETA",
    "GAMMA",
    "BoundedPull",
    "Clip",
    "PoseSolver",
    "PoseState",
    "PosingSession",
    "Sculpt",
    "interpolate",
    "interpolate_gaze",
    "replay",
]
