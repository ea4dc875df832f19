"""From markers or a scan to one mesh: a neutral and whole takes (Tena et al. 2011, section 4.1)."""

from facelab.registration.fit import Fit, MarkerFit, fit_markers, fit_scan
from facelab.registration.layout import MarkerLayout
from facelab.registration.report import FitReport
from facelab.registration.rest import rest_markers
from facelab.registration.sequence import Fault, Registration, register_sequence
from facelab.registration.warp import PRESETS

__all__ = [
    "PRESETS",
    "Fault",
    "Fit",
    "FitReport",
    "MarkerFit",
    "MarkerLayout",
    "Registration",
    "fit_markers",
    "fit_scan",
    "register_sequence",
    "rest_markers",
]
