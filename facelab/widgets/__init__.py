"""Views for the notebook: ipywidgets and pythreejs on top of the sessions."""

from facelab.widgets.alpha_view import AlphaView
from facelab.widgets.error_view import ErrorView
from facelab.widgets.expression_lab import ExpressionLab
from facelab.widgets.landmark_picker import LandmarkPicker
from facelab.widgets.player import Player
from facelab.widgets.posing_lab import PosingLab
from facelab.widgets.registration_view import RegistrationView
from facelab.widgets.segmentation_view import SegmentationView
from facelab.widgets.viewer import FaceView

__all__ = [
    "AlphaView",
    "ErrorView",
    "ExpressionLab",
    "FaceView",
    "LandmarkPicker",
    "Player",
    "PosingLab",
    "RegistrationView",
    "SegmentationView",
]
