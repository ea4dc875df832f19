"""Linear models of a face in motion (Tena et al. 2011, sections 3.1 and 5)."""

from facelab.face_model import FaceModel
from facelab.models.components import components_of_blocks, principal_components
from facelab.models.evaluation import (
    ErrorCurve,
    error_curves,
    frame_errors,
    rank_of_motion,
    rms_error,
    sparse_model,
    variance_across,
)
from facelab.models.global_local import GlobalLocalModel
from facelab.models.holistic import HolisticModel
from facelab.models.localised import localised_model, varimax
from facelab.models.region import RegionModel
from facelab.models.store import load_model

__all__ = [
    "ErrorCurve",
    "FaceModel",
    "GlobalLocalModel",
    "HolisticModel",
    "RegionModel",
    "components_of_blocks",
    "error_curves",
    "frame_errors",
    "load_model",
    "localised_model",
    "principal_components",
    "rank_of_motion",
    "rms_error",
    "sparse_model",
    "variance_across",
    "varimax",
]
