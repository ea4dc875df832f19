"""Aura: a production head of 72 action units, and animation of it, as a second real topology."""

import os
from pathlib import Path

import numpy as np
import pooch

from facelab.checks import check_number
from facelab.data.cache import download
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.polygons import triangulate
from facelab.keeping import cache_dir
from facelab.motion import WeightSequence
from facelab.rig import BlendshapeRig

_RAW = "https://raw.githubusercontent.com/"
_FILES = {  # what it is called in a folder: its address up to the name there, that name, SHA-256
    "aura_compressed.npz": (
        f"{_RAW}martinlanton/meta-compskin/8741eed6730fbfc3b762f46ba2c5f4a36807ec1b/tests/test_data/",
        "expected_aura.npz",
        "78a8e9cbf51bd2ae5b4e2afcec456f07b952b78ba0ccd1d28678e6ee1c4711e9",
    ),
    "test_anim.npz": (
        f"{_RAW}facebookresearch/compskin/22e6f5fa19e533d84916bb1abd9dc88c4ac3054e/in/",
        "test_anim.npz",
        "1b1f64cc9d4f7ad5b81b8627fc283d96658a977af4eed5665e0543c4cbd081e0",
    ),
}


def _sides(ends, *stems):
    return [f"{stem}_{end}" for stem in stems for end in ends]


_LR, _QUARTERS = ("L", "R"), ("LB", "LT", "RB", "RT")  # side; bottom or top
AURA_UNITS = (
    *_sides(_LR, "browDown", "cheekPuff", "cheekRaiser", "cheekSuck"),
    *("chinRaiser_B", "chinRaiser_T"),
    *_sides(_LR, "dimpler", "eyesClosed", "eyesLookDown", "eyesLookLeft", "eyesLookRight"),
    *_sides(_LR, "eyesLookUp", "innerBrowRaiser"),
    *("jawDrop", "jawSidewaysLeft", "jawSidewaysRight", "jawThrust"),
    *_sides(_LR, "lidTightener", "lipCornerDepressor", "lipCornerPuller"),
    *_sides(_QUARTERS, "lipFunneler"),
    *_sides(_LR, "lipPressor", "lipPucker"),
    *_sides(_QUARTERS, "lipsToward"),
    *_sides(_LR, "lipStretcher"),
    *_sides(_QUARTERS, "lipSuck"),
    *_sides(_LR, "lipTightener", "mouthLowerDown"),
    *("mouthLeft", "mouthRight"),
    *_sides(_LR, "nasolabialFurrow", "noseWrinkler", "nostrilCompressor", "nostrilDilator"),
    *_sides(_LR, "outerBrowRaiser", "upperLidRaiser", "upperLipRaiser"),
)
"""The 72 action units of Aura, in the order of its source."""

AURA_LANDMARKS = {
    **{"nose_tip": 2903, "chin": 2970, "lip_upper": 2889, "lip_lower": 2861},
    **{"mouth_corner_left": 2460, "mouth_corner_right": 5481},
    **{"eye_left_inner": 2188, "eye_left_outer": 1463},
    **{"eye_right_inner": 5210, "eye_right_outer": 4485},
}
"""Ten vertices guessed from the shapes: the source names none."""


def load_aura(root=None):
    """The production head Aura: one piece of skin with neck, 72 action units, ten landmarks.

    Of "Compressed Skinning for Facial Blendshapes" (SIGGRAPH 2024; Apache
    License 2.0), as its authors compressed it: 0.04 mm from the original on average. Eye sockets
    and the bag of the mouth are part of the skin; there are no eyes, teeth or textures. The
    in-betweens and combinations of the source are left out.

    Parameters
    ----------
    root : str or Path, optional
        Folder with `aura_compressed.npz` (or `expected_aura.npz`); else the environment variable
        `FACELAB_AURA`, the cache, or a download of the pinned file (1 MB).

    Returns
    -------
    BlendshapeRig
        5,944 vertices, millimetres; left and right are the person's. The 5,924 quads are cut: the
        triangles 2 k and 2 k + 1 are quad k.

    Raises
    ------
    DataUnavailable
        If the file is not on this machine and cannot, or must not, be downloaded.
    FileNotFoundError, ValueError
        For a folder without the file, or a file that is another one.

    Examples
    --------
    >>> import facelab
    >>> facelab.data.load_aura()
    BlendshapeRig(72 shapes on 5944 vertices)
    """
    with np.load(_aura_file("aura_compressed.npz", root)) as data:
        rest, quads = data["rest"].astype(float), data["quads"].astype(np.int64)
        bones, frames = data["weights"].astype(float), data["shapeXform"].astype(float)
    S = frames.reshape(-1, 3, bones.shape[1], 4)[: len(AURA_UNITS)]
    homogeneous = np.c_[rest, np.ones(len(rest))]
    # d_k(v) = sum over bones b of w_vb S_kb (v, 1): linear blend skinning of the rest pose
    d = np.einsum("vb,kxbh,vh->kvx", bones, S, homogeneous, optimize=True)
    cm_to_mm = 10.0
    faces, _ = triangulate(rest, quads.ravel(), np.full(len(quads), 4))
    neutral = TriangleMesh(cm_to_mm * rest, faces, AURA_LANDMARKS)
    return BlendshapeRig(neutral, AURA_UNITS, (cm_to_mm * d).astype(np.float32))


def load_aura_take(root=None, fps=60.0):
    """Production animation of Aura: its 72 units over 2,800 frames.

    Parameters
    ----------
    root : str or Path, optional
        Folder with `test_anim.npz`; else as for `load_aura`.
    fps : float, default=60
        Frames a second. The source does not say; at 60 a blink lasts an eighth of a second.

    Returns
    -------
    WeightSequence
        As in the source: within 0 and 1, but for three units that reach -0.064 in a few frames.

    Raises
    ------
    DataUnavailable, FileNotFoundError, ValueError
        As `load_aura`.

    Examples
    --------
    >>> import facelab
    >>> facelab.data.load_aura_take().n_frames
    2800
    """
    fps = check_number(fps, "fps", above=0)
    with np.load(_aura_file("test_anim.npz", root)) as data:
        weights = data["weights"][:, : len(AURA_UNITS)].astype(float)
    return WeightSequence(weights, AURA_UNITS, fps)


def _aura_file(name, root):
    """Path of a file of Aura, which is the pinned one wherever it lies."""
    base, there, sha256 = _FILES[name]
    named = root or os.environ.get("FACELAB_AURA")
    if not named:
        return download(base, there, sha256, cache_dir() / "aura")
    found = [f for f in (Path(named) / name, Path(named) / there) if f.is_file()]
    if not found:
        raise FileNotFoundError(
            f"{'root' if root else 'FACELAB_AURA'}={str(named)!r} holds no {name}; give the folder "
            "with the files of Aura."
        )
    if pooch.file_hash(found[0]) != sha256:
        raise ValueError(f"{found[0]} is not the file it should be; fetch it again: {base}{there}")
    return found[0]
