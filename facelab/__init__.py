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
============== ===================== ======================================== ================
"""

from facelab.alignment import procrustes
from facelab.blendshapes import BlendshapeRig
from facelab.c3d import read_c3d, write_c3d
from facelab.datasets import (
    DataUnavailable,
    load_capture,
    load_example,
    load_ict_facekit,
    load_ict_props,
    load_take,
    load_template,
)
from facelab.deformation import LinearBinding, bind
from facelab.evaluation import rms_error
from facelab.io import read_live_link_csv, read_mesh, read_obj, write_obj, write_ply
from facelab.mesh import MULTI_PIE, TriangleMesh
from facelab.models import HolisticModel, RegionModel
from facelab.motion import MarkerSequence, MotionSequence, WeightSequence
from facelab.posing import PoseSolver, PosingSession
from facelab.registered import RegisteredActor, load_registered
from facelab.registration import fit_markers, fit_scan, rest_markers
from facelab.segmentation import Regions, segment_face
from facelab.sequences import Registration, register_sequence

__all__ = [
    "MULTI_PIE",
    "BlendshapeRig",
    "DataUnavailable",
    "HolisticModel",
    "LinearBinding",
    "MarkerSequence",
    "MotionSequence",
    "PoseSolver",
    "PosingSession",
    "RegionModel",
    "Regions",
    "RegisteredActor",
    "Registration",
    "TriangleMesh",
    "WeightSequence",
    "bind",
    "fit_markers",
    "fit_scan",
    "load_capture",
    "load_example",
    "load_ict_facekit",
    "load_ict_props",
    "load_registered",
    "load_take",
    "load_template",
    "procrustes",
    "read_c3d",
    "read_live_link_csv",
    "read_mesh",
    "read_obj",
    "register_sequence",
    "rest_markers",
    "rms_error",
    "segment_face",
    "write_c3d",
    "write_obj",
    "write_ply",
]
