"""One room for each kind of file, in and out."""

from facelab.files.gltf import write_clip_glb, write_glb, write_motion_glb
from facelab.files.into import write_into
from facelab.files.landmarks import read_landmarks, write_landmarks
from facelab.files.markers import read_c3d, read_markers, write_c3d
from facelab.files.meshes import read_mesh, read_parts
from facelab.files.npz import npz_kind, read_face, read_motion, write_face, write_motion
from facelab.files.obj import read_obj, write_obj
from facelab.files.ply import write_ply
from facelab.files.poses import (
    load_clip,
    load_library,
    load_pose,
    read_log,
    save_clip,
    save_library,
    save_pose,
)
from facelab.files.rigs import read_rig, write_rig
from facelab.files.takes import (
    read_live_link_csv,
    read_weights,
    to_arkit,
    write_live_link_csv,
    write_weights_csv,
)

__all__ = [
    "load_clip",
    "load_library",
    "load_pose",
    "npz_kind",
    "read_c3d",
    "read_face",
    "read_landmarks",
    "read_live_link_csv",
    "read_log",
    "read_markers",
    "read_mesh",
    "read_motion",
    "read_obj",
    "read_parts",
    "read_rig",
    "read_weights",
    "save_clip",
    "save_library",
    "save_pose",
    "to_arkit",
    "write_c3d",
    "write_clip_glb",
    "write_face",
    "write_glb",
    "write_into",
    "write_landmarks",
    "write_live_link_csv",
    "write_motion",
    "write_motion_glb",
    "write_obj",
    "write_ply",
    "write_rig",
    "write_weights_csv",
]
