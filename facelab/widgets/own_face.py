"""What the posing lab shows of a rig of one's own."""

from pathlib import Path

import numpy as np

from facelab.expression.landmarks import guess_landmarks
from facelab.geometry.mesh import TriangleMesh
from facelab.looks import Prop, face_props
from facelab.numeric.least_squares import solve_bounded
from facelab.pipeline import model_from_take

_NOISE = 0.3  # mm per axis, as a capture has it; less is no motion
_MOVES = 1e-3  # mm: what moves less is still
_RIDGE = 1e-3  # of what a shape moves: where two shapes say the same, each gets its share
_PART = (0.86, 0.85, 0.83)  # colour of parts that the file has none for


def own_face(rig, take=None, n_components=20, n_regions=9):
    """Arguments of `PosingLab` for a rig: its session, models, parts and takes.

    The region model learns from the take, or from plausible mixtures of the rig's own shapes. Of a
    head in pieces the one that moves most is posed; the others (eyes, teeth) go as the shapes of
    the file move them.

    Returns
    -------
    arguments : dict
    about : str
        What is shown, in words.
    """
    pieces, parts = rig.neutral.pieces, dict(rig.parts)
    name = "A rig" if rig.source is None else Path(rig.source.path).name
    about = f"{name}: {len(rig.names)} shapes on {rig.neutral.n_vertices:,} vertices"
    if pieces.any():
        moved = np.abs(rig.deltas).max(axis=(0, 2)) > _MOVES
        face = pieces == np.bincount(pieces, moved).argmax()
        parts["other pieces"] = rig.on(np.flatnonzero(~face))
        about += f" in {pieces.max() + 1} pieces, of which the largest that moves is posed"
        rig = rig.on(np.flatnonzero(face))
    mixed = take is None
    if not mixed:
        _refuse_still(rig, take)
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
        "props": shown_parts(rig, parts),
        "takes": {} if mixed else {"take": (small.animate(take), take)},
    }
    return arguments, about


def _refuse_still(rig, take):
    """Of a take that holds the face still a model would learn the noise that is put on it."""
    W = rig.rig_weights(take)[take.valid]
    reach = np.ptp(W, axis=0) @ np.abs(rig.deltas).max(axis=(1, 2)) if len(W) else 0
    if reach < _NOISE:
        raise ValueError(
            f"take moves the rig by {reach:.2g} mm in {len(W)} valid frames, and a region model "
            "learns from motion; give a take of expressions, or none: it then learns from mixtures "
            "of the rig's shapes."
        )


def shown_parts(rig, parts):
    """What is shown beside the skin of a rig: list of Prop.

    The parts of its file, each moved by its own shapes as strongly as those of the same name move
    the skin; for a face that has none, eyes and teeth made for it. Where a file has no landmarks
    they are guessed, for this alone.

    Parameters
    ----------
    rig : BlendshapeRig
        The skin.
    parts : dict of str to BlendshapeRig or TriangleMesh
        In the same place; those without shapes stay still.
    """
    if parts:
        weights = _weights_of_poses(rig)
        return [_shown(name, part, rig, weights) for name, part in parts.items()]
    face = rig.neutral
    if not face.landmarks:
        try:
            face = TriangleMesh(face.vertices, face.faces, guess_landmarks(rig))
        except ValueError:  # of other shapes
            return []
    return face_props(face, rig)


def _shown(name, part, rig, weights):
    mesh, move = getattr(part, "neutral", part), None
    colors = _colors(mesh)
    own = [k for k, n in enumerate(rig.names) if n in getattr(part, "names", ())]
    if own:
        deltas = part.deltas[[part.names.index(rig.names[k]) for k in own]]

        def move(V):
            return mesh.vertices + np.tensordot(weights(V)[own], deltas, axes=1)

    return Prop(name, mesh, colors, move, gloss=float(colors.max() > 0.5))  # the bright ones shine


def _weights_of_poses(rig):
    """How strongly the shapes of a rig act in a pose of its skin: callable (n, 3) to (n_shapes,).

    Least squares within 0 and 1 over some vertices; a shape that moves none of them is at 0.
    """
    seen = rig.neutral.subsample(min(397, rig.neutral.n_vertices))[0]
    rest, D = rig.neutral.vertices[seen], rig.deltas[:, seen].reshape(len(rig.names), -1)
    H = D @ D.T
    moves = H.diagonal() > _MOVES**2
    H[np.diag_indices_from(H)] = np.where(moves, (1 + _RIDGE) * H.diagonal(), 1.0)

    def weights(V):
        g = D @ (V[seen] - rest).ravel()
        return solve_bounded(H, g, np.zeros(len(g)), moves.astype(float))[0]

    return weights


def _colors(mesh):
    if mesh.texture is None:
        return np.tile(_PART, (mesh.n_vertices, 1))
    return mesh.texture.at_vertices(mesh.faces, mesh.n_vertices, _PART)
