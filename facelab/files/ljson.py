"""Landmarks as menpo's JSON (.ljson): points with labels."""

import json

import numpy as np

from facelab.checks import as_finite, check_index
from facelab.files.json_items import load_json
from facelab.storage import atomic_path, existing_file

_OFF = 1.0  # mm; a point farther from all vertices is of another mesh


def write_landmarks(path, vertices, landmarks):
    """Write landmarks as .ljson, whole or not at all.

    Parameters
    ----------
    path : str or Path
    vertices : ndarray of shape (n_vertices, 3)
        Of the mesh, in the unit that the file shall have.
    landmarks : dict of str to int
        Vertex of each.

    Raises
    ------
    ValueError, TypeError
        For no landmarks, or one that is no vertex of the mesh.

    References
    ----------
    menpo project, landmark file format, version 3.
    """
    vertices = as_finite(vertices, "vertices", ("n_vertices", 3))
    if not landmarks:
        raise ValueError("landmarks is empty; set one or more first.")
    at = [
        check_index(v, f"landmarks[{n!r}]", len(vertices), "vertices") for n, v in landmarks.items()
    ]
    own = np.eye(len(at), dtype=bool).tolist()
    labels = [{"label": n, "mask": m} for n, m in zip(landmarks, own, strict=True)]
    group = {
        "landmarks": {"points": vertices[at].tolist(), "connectivity": []},
        "labels": labels,
    }
    with atomic_path(path) as part:
        part.write_text(json.dumps({"version": 3, "groups": {"PTS": group}}, ensure_ascii=False))


def read_landmarks(path, mesh):
    """The landmarks of a mesh: a dict of names to vertices, from a JSON file.

    Parameters
    ----------
    path : str or Path
        `.ljson` of menpo or `LandmarkPicker`, points with labels in the mesh's millimetres; or
        JSON with the vertex (from 0) of each name, `{"chin": 1204, "nose_tip": 87}`.
    mesh : TriangleMesh

    Returns
    -------
    dict of str to int

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing or damaged file, a vertex that the mesh does not have, a label of several
        points, or a point that lies 1 mm or more from every vertex.

    Examples
    --------
    >>> import facelab
    >>> from pathlib import Path
    >>> _ = Path("marks.json").write_text('{"chin": 12}')
    >>> facelab.files.read_landmarks("marks.json", facelab.load_template(4375))
    {'chin': 12}
    """
    path = existing_file(path, "file of landmarks")
    held = load_json(path.read_bytes(), path, "file of landmarks").value
    try:
        found = _of_points(held, mesh) if "groups" in held else held
        if not found:
            raise ValueError("it names no landmark")
        return {n: check_index(v, repr(n), mesh.n_vertices, "vertices") for n, v in found.items()}
    except (ValueError, TypeError) as error:  # ours
        raise ValueError(f"{path}: {str(error).rstrip('.')}.") from None


def _of_points(held, mesh):
    group = held["groups"]
    group = next(iter(group.values())) if isinstance(group, dict) and len(group) == 1 else None
    points = group.get("landmarks") if isinstance(group, dict) else None
    labels = group.get("labels") if isinstance(group, dict) else None
    if not isinstance(points, dict) or not isinstance(labels, list):
        raise ValueError("it should have one group, with landmarks and labels")
    points = as_finite(points.get("points"), "points", ("n_points", 3))
    found = {}
    for label in labels:
        label = label if isinstance(label, dict) else {}
        name, mask = label.get("label"), label.get("mask")
        if not isinstance(name, str) or not isinstance(mask, list) or len(mask) != len(points):
            raise ValueError(f"labels[{len(found)}] should have a label, and a mask of the points")
        here = np.flatnonzero([m is True for m in mask])
        if name in found or len(here) != 1:
            raise ValueError(f"the label {name!r} should stand there once, for one point")
        away = np.linalg.norm(mesh.vertices - points[here[0]], axis=1)
        if away.min() >= _OFF:
            raise ValueError(
                f"{name!r} lies {away.min():.3g} mm from the nearest vertex: it is of another "
                "mesh, or in another unit; mark this mesh, in millimetres"
            )
        found[name] = int(away.argmin())
    return found
