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
from facelab.deformation import LinearBinding, bind, laplacian_deform
from facelab.evaluation import rms_error
from facelab.exports import read_weights_csv, to_arkit, write_live_link_csv, write_weights_csv
from facelab.expression import ExpressionFit, regress_expression
from facelab.expression_sequence import regress_sequence
from facelab.expression_session import ExpressionSession
from facelab.expression_units import prepare_units
from facelab.gltf import write_clip_glb, write_glb
from facelab.io import read_live_link_csv, read_mesh, read_obj, write_obj, write_ply
from facelab.mesh import MULTI_PIE, TriangleMesh
from facelab.models import HolisticModel, RegionModel, load_model
from facelab.motion import MarkerSequence, MotionSequence, WeightSequence
from facelab.poses import Clip, load_clip, load_pose, read_log, replay, save_clip, save_pose
from facelab.posing import PoseSolver, PosingSession
from facelab.registered import RegisteredActor, load_registered
from facelab.registration import fit_markers, fit_scan, rest_markers
from facelab.sculpt import Sculpt
from facelab.segmentation import Likeness, Regions, segment_face
from facelab.sequences import Registration, register_sequence
from facelab.transfer import IntermediateSpace

__all__ = [
    "MULTI_PIE",
    "BlendshapeRig",
    "Clip",
    "DataUnavailable",
    "ExpressionFit",
    "ExpressionSession",
    "HolisticModel",
    "IntermediateSpace",
    "Likeness",
    "LinearBinding",
    "MarkerSequence",
    "MotionSequence",
    "PoseSolver",
    "PosingSession",
    "RegionModel",
    "Regions",
    "RegisteredActor",
    "Registration",
    "Sculpt",
    "TriangleMesh",
    "WeightSequence",
    "bind",
    "fit_markers",
    "fit_scan",
    "laplacian_deform",
    "load_capture",
    "load_clip",
    "load_example",
    "load_ict_facekit",
    "load_ict_props",
    "load_model",
    "load_pose",
    "load_registered",
    "load_take",
    "load_template",
    "prepare_units",
    "procrustes",
    "read_c3d",
    "read_live_link_csv",
    "read_log",
    "read_mesh",
    "read_obj",
    "read_weights_csv",
    "register_sequence",
    "regress_expression",
    "regress_sequence",
    "replay",
    "rest_markers",
    "rms_error",
    "save_clip",
    "save_pose",
    "segment_face",
    "to_arkit",
    "write_c3d",
    "write_clip_glb",
    "write_glb",
    "write_live_link_csv",
    "write_obj",
    "write_ply",
    "write_weights_csv",
]
