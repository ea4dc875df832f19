"""What the posing lab shows of a rig of one's own."""

from pathlib import Path

import numpy as np

from facelab.expression.landmarks import guess_landmarks
from facelab.geometry.mesh import TriangleMesh
from facelab.looks import face_props
from facelab.pipeline import model_from_take

_NOISE = 0.3  # mm per axis, as a capture has it
_MOVES = 1e-3  # mm: what moves less is still
_PART = (0.86, 0.85, 0.83)  # colour of parts that the file has none for


def own_face(rig, take=None, n_components=20, n_regions=9):
    """Arguments of `PosingLab` for a rig: its session, models, still parts and takes.

    The region model learns from the take, or from plausible mixtures of the rig's own shapes. Of a
    head in pieces the one that moves most is posed, the others (eyes, teeth) are shown still.

    Returns
    -------
    arguments : dict
    about : str
        What is shown, in words.
    """
    pieces, still = (
        rig.neutral.pieces,
        [getattr(part, "neutral", part) for part in rig.parts.values()],
    )
    name = "A rig" if rig.source is None else Path(rig.source.path).name
    about = f"{name}: {len(rig.names)} shapes on {rig.neutral.n_vertices:,} vertices"
    if pieces.any():
        moved = np.abs(rig.deltas).max(axis=(0, 2)) > _MOVES
        face = pieces == np.bincount(pieces, moved).argmax()
        still.append(rig.neutral.submesh(~face))
        about += f" in {pieces.max() + 1} pieces, of which the largest that moves is posed"
        rig = rig.on(np.flatnonzero(face))
    mixed = take is None
    learned = model_from_take(
        rig.plausible_mixtures() if mixed else take,
        rig,
        n_components=n_components,
        n_regions=n_regions,
        noise=_NOISE,
        progress=False,
    )
    source = "plausible mixtures of its own shapes" if mixed else "the take"
    about += f". The region model has {learned.regions.n_regions} regions, learned from {source}."
    small = rig.on(learned.samples, learned.control)
    arguments = {
        "session": learned.session(),
        "models": {"region": learned.model, "rig": rig},
        "props": _shown(rig, still),
        "takes": {} if mixed else {"take": (small.animate(take), take)},
    }
    return arguments, about


def _shown(rig, still):
    """The parts of the file; for a face that has none, eyes and teeth made for it.

    Where a file has no landmarks they are guessed, for this alone.
    """
    if still:
        return [(mesh, _colors(mesh)) for mesh in still]
    face = rig.neutral
    if not face.landmarks:
        try:
            face = TriangleMesh(face.vertices, face.faces, guess_landmarks(rig))
        except ValueError:  # of other shapes
            return []
    return face_props(face, rig)


def _colors(mesh):
    if mesh.texture is None:
        return np.tile(_PART, (mesh.n_vertices, 1))
    return mesh.texture.at_vertices(mesh.faces, mesh.n_vertices, _PART)
