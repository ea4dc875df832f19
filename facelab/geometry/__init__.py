"""Meshes and what moves them: alignment, deformation, bindings, symmetry."""

from facelab.geometry.alignment import (
    Alignment,
    HeadMotion,
    procrustes,
    rigid_motion,
    rigid_weights,
)
from facelab.geometry.binding import LinearBinding, SurfaceBinding, bind_to_samples, bind_to_surface
from facelab.geometry.closest import closest_points
from facelab.geometry.deformation import LaplacianDeformer, laplacian_deform
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh, vertex_normals
from facelab.geometry.size import check_face_size, face_scale, longest_side
from facelab.geometry.symmetry import (
    mirror_agreement,
    mirror_partners,
    mirror_twins,
    mirror_weights,
    mirrored,
    one_sided,
    other_side,
    symmetrised,
)
from facelab.geometry.texture import Texture
from facelab.geometry.winding import outwards

__all__ = [
    "MULTI_PIE",
    "Alignment",
    "HeadMotion",
    "LaplacianDeformer",
    "LinearBinding",
    "SurfaceBinding",
    "Texture",
    "TriangleMesh",
    "bind_to_samples",
    "bind_to_surface",
    "check_face_size",
    "closest_points",
    "face_scale",
    "laplacian_deform",
    "longest_side",
    "mirror_agreement",
    "mirror_partners",
    "mirror_twins",
    "mirror_weights",
    "mirrored",
    "one_sided",
    "other_side",
    "outwards",
    "procrustes",
    "rigid_motion",
    "rigid_weights",
    "symmetrised",
    "vertex_normals",
]
