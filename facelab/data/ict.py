"""Ready data: the generic face of ICT-FaceKit and recorded performances to drive it.

Each is looked for in this order: an argument, an environment variable, the cache; else it is
downloaded once, with checksums. `python -m facelab.data` does that ahead of time.
"""

import hashlib
import json
import os
from importlib import resources
from pathlib import Path

import numpy as np
from tqdm.auto import tqdm

from facelab.checks import check_choice
from facelab.data.cache import download
from facelab.files.obj import read_obj, read_obj_vertices
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.keeping import cache_dir, keep_arrays
from facelab.looks import face_props
from facelab.rig import BlendshapeRig

_VERSION = 2  # of what is parsed and kept
_CM_TO_MM = 10.0

ICT_URL = "https://raw.githubusercontent.com/ICT-VGL/ICT-FaceKit/da5f95a/FaceXModel/"


ICT_AREAS = {"narrow": (6706, 6560), "face": (9409, 9230), "all": (26719, 26384)}
"""Parts of the ICT mesh: number of vertices and polygons, counted from the first."""


def _ict_checksums():
    text = resources.files("facelab.data").joinpath("ict_sha256.txt").read_text(encoding="utf-8")
    return {name: digest for digest, name in (line.split() for line in text.splitlines())}


def _ict_folder(root):
    """Folder with the ICT files, or None where they must be downloaded."""
    named = root or os.environ.get("FACELAB_ICT")
    if not named:
        return None
    for folder in (Path(named) / "FaceXModel", Path(named)):
        if (folder / "generic_neutral_mesh.obj").is_file():
            return folder
    raise FileNotFoundError(
        f"{'root' if root else 'FACELAB_ICT'}={str(named)!r} holds no FaceXModel/"
        "generic_neutral_mesh.obj; give the folder of a clone of ICT-FaceKit."
    )


def load_ict_facekit(root=None, area="narrow", n_identities=0):
    """The generic face of ICT-FaceKit: neutral, 68 landmarks, 53 expressions.

    The files are parsed once and kept in the cache.

    Parameters
    ----------
    root : str or Path, optional
        A clone of ICT-FaceKit; else the environment variable `FACELAB_ICT`, the cache, or a
        download of the pinned files (190 MB).
    area : {"narrow", "face", "all"}
        Without ears and neck (6,706 vertices), with them (9,409), or with eyes, teeth and the
        inside of the mouth (26,719).
    n_identities : int, default=0
        Identity modes to load, 0 to 100.

    Returns
    -------
    BlendshapeRig
        Millimetres. Names as in the source (`mouthSmile_L`; left and right are the person's).

    Raises
    ------
    DataUnavailable
        If the files are not on this machine and cannot, or must not, be downloaded.
    FileNotFoundError, ValueError
        For a folder without the files, an unknown area, damaged files.

    References
    ----------
    Li et al., Learning Formation of Physically-Based Face Attributes, CVPR 2020.

    Examples
    --------
    >>> import facelab
    >>> facelab.load_ict_facekit()
    BlendshapeRig(53 shapes on 6706 vertices)
    """
    check_choice(area, "area", tuple(ICT_AREAS))
    if not 0 <= n_identities <= 100:
        raise ValueError(f"n_identities={n_identities}, but ICT-FaceKit has 100: 0 to 100.")
    n_vertices, n_polygons = ICT_AREAS[area]
    data = _ict_arrays(_ict_folder(root), n_identities)
    faces = data["faces"][data["polygon"] < n_polygons]
    landmarks = dict(zip(MULTI_PIE, data["landmarks"].tolist(), strict=True))
    neutral = TriangleMesh(data["neutral"][:n_vertices], faces, landmarks)
    identities = {
        f"identity{i:03d}": shift[:n_vertices] for i, shift in enumerate(data["identities"])
    }
    names = tuple(data["names"].tolist())
    return BlendshapeRig(neutral, names, data["deltas"][:, :n_vertices], identities)


def load_ict_props(root=None):
    """Eyes that turn with the look shapes, teeth and a tongue, to be shown with the face.

    Returns
    -------
    list of facelab.looks.Prop
        Made by `facelab.looks.face_props`: in the source, eyes do not turn with its shapes.
    """
    rig = load_ict_facekit(root)
    return face_props(rig.neutral, rig)


def _ict_arrays(folder, n_identities):
    """All of ICT-FaceKit as arrays in millimetres, from the cache if it was parsed before."""
    checksums = _ict_checksums()
    if folder is None:
        stamp = "pinned"
    else:
        about = [(str(f), f.stat().st_size, f.stat().st_mtime_ns) for f in sorted(folder.iterdir())]
        stamp = hashlib.sha256(repr(about).encode()).hexdigest()[:12]

    def file(name):
        if folder is None:
            return download(ICT_URL, name, checksums[name], cache_dir() / "ICT-FaceKit")
        return folder / name

    key = {"version": _VERSION}
    arrays = keep_arrays(f"ict_{stamp}", key, lambda: _parsed(file))
    people = {"identities": arrays["deltas"][:0]}
    if n_identities:
        names = [f"identity{i:03d}" for i in range(n_identities)]
        people = keep_arrays(
            f"ict_{stamp}_{n_identities}",
            key,
            lambda: {"identities": _shifts(file, names, arrays["neutral"])},
        )
    return arrays | people


def _parsed(file):
    """The arrays of neutral and expressions from the files that `file` gives by name."""
    try:
        index = json.loads(file("vertex_indices.json").read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{file('vertex_indices.json')} is damaged ({error}).") from error
    mesh = read_obj(file("generic_neutral_mesh.obj"))
    if mesh.n_vertices != ICT_AREAS["all"][0]:
        raise ValueError(
            f"{file('generic_neutral_mesh.obj')} has {mesh.n_vertices} vertices, but ICT-FaceKit "
            f"has {ICT_AREAS['all'][0]}; clone the repository again."
        )
    V = mesh.vertices * _CM_TO_MM
    return dict(
        neutral=V,
        faces=mesh.faces,
        polygon=_polygon_of_each_face(file("generic_neutral_mesh.obj")),
        landmarks=np.array(index["idx_to_landmark_verts"]),
        names=np.array(index["expressions"]),
        deltas=_shifts(file, index["expressions"], V),
    )


def _shifts(file, names, V):
    """Shapes of the files as displacements from the neutral, mm: float32, (n_shapes, n, 3)."""
    shifts = np.empty((len(names), *V.shape), dtype=np.float32)
    for k, name in enumerate(tqdm(names, desc="ICT-FaceKit", unit="shape")):
        shape = read_obj_vertices(file(f"{name}.obj"))
        if shape.shape != V.shape:
            raise ValueError(f"{name}.obj has {len(shape)} vertices, the neutral {len(V)}.")
        shifts[k] = shape * _CM_TO_MM - V
    return shifts


def _polygon_of_each_face(path):
    """Number of the polygon that each triangle of `read_obj` comes from."""
    corners = [len(line.split()) - 1 for line in path.read_text().splitlines() if line[:2] == "f "]
    return np.repeat(np.arange(len(corners)), np.array(corners) - 2)
