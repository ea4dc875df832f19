"""facelab: a lab in which people learn, use and extend linear 3D face models.

Symbols, from words at the boundary to letters inside (Tena et al. 2011; Yu and Liu 2014):

============== ===================== ======================================== ================
symbol         name                  what                                     paper
============== ===================== ======================================== ================
v, B, c                              shape (mm), basis, coefficients          Tena Eq. 1
M, P           n_regions,            regions; modes of each                   Tena Eq. 5
               n_components
zeta           Z, coefficients       all regions' coefficients stacked, (P,)  Tena Eq. 5
beta           beta                  weight of boundary agreement             Tena Eq. 6, 9
gamma          gamma                 weight of staying near c_0               Tena Eq. 8, 9
C-bar, G, A    C_bar, G, A           correlation, mesh distance (mm), both    Tena Eq. 11, 12
lambda, r      lam, r                correlation against distance; mm         Tena Eq. 11, 12
E_RMS          rms_error             root mean squared distance, mm           Tena Eq. 13
d_i, w_i       deltas, weights       action-unit displacements (mm), weights  Yu Eq. 1, 3
alpha, lambda  alphas, lam           wanted sum of weights; its weight, mm    Yu Eq. 8, 9
e_rms          e_rms, rms            Eq. 10 as printed; a true RMS, mm        Yu Eq. 10
alpha          anchor_weight         pull of the anchors of a deformation     Yu Eq. 12
============== ===================== ======================================== ================
"""

import importlib
import importlib.util
import warnings

__all__ = [
    "BlendshapeRig",
    "DataUnavailable",
    "ExpressionSession",
    "HolisticModel",
    "IntermediateSpace",
    "MarkerSequence",
    "MotionSequence",
    "PosingSession",
    "RegionModel",
    "TriangleMesh",
    "WeightSequence",
    "bind_to_samples",
    "data",
    "expression",
    "files",
    "fit_markers",
    "fit_scan",
    "geometry",
    "load_example",
    "load_ict_facekit",
    "load_markers",
    "load_registered",
    "load_take",
    "load_template",
    "model_from_take",
    "models",
    "numeric",
    "posing",
    "read_markers",
    "read_mesh",
    "read_rig",
    "read_weights",
    "register_sequence",
    "registration",
    "regress_expression",
    "rms_error",
    "segment_face",
    "segmentation",
    "studies",
]

_HOMES = {
    "data": (
        "DataUnavailable load_example load_ict_facekit load_markers load_registered load_take "
        "load_template"
    ),
    "expression": "ExpressionSession IntermediateSpace regress_expression",
    "files": "read_markers read_mesh read_rig read_weights",
    "geometry": "TriangleMesh bind_to_samples",
    "models": "HolisticModel RegionModel rms_error",
    "motion": "MarkerSequence MotionSequence WeightSequence",
    "pipeline": "model_from_take",
    "posing": "PosingSession",
    "registration": "fit_markers fit_scan register_sequence",
    "rig": "BlendshapeRig",
    "segmentation": "segment_face",
}
_HOME = {name: home for home, names in _HOMES.items() for name in names.split()}
"""Where each name is imported from, at its first use: all together take seconds."""
_ROOMS = [name for name in __all__ if name not in _HOME]


def __getattr__(name):
    if name in _HOME:
        globals()[name] = getattr(importlib.import_module(f"facelab.{_HOME[name]}"), name)
        return globals()[name]
    if not name.startswith("_") and importlib.util.find_spec(f"facelab.{name}"):
        return importlib.import_module(f"facelab.{name}")
    return _moved(name)


def __dir__():
    return sorted({*globals(), *__all__})


def _moved(name):
    """Names that stood here before there were rooms are still found, with a word."""
    for room in () if name.startswith("_") else _ROOMS:
        home = importlib.import_module(f"facelab.{room}")
        if name in getattr(home, "__all__", ()):
            where = f"{home.__name__}.{name}"
            warnings.warn(
                f"facelab.{name} is now {where}; use that.", DeprecationWarning, stacklevel=3
            )
            return getattr(home, name)
    raise AttributeError(f"facelab has no {name!r}; see dir(facelab) and its rooms.")
