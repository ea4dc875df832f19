"""Landmarks as menpo's JSON (.ljson): points with labels."""

import json

import numpy as np

from facelab.checks import as_finite, check_index
from facelab.storage import atomic_path


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
