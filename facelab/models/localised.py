"""Modes that move one place each, made of whole-face modes or learned as such.

For comparison with regions: `varimax` turns modes and keeps what they span, `localised_model`
learns sparse localised components.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from facelab.checks import as_finite, check_count, check_number, check_type
from facelab.geometry.mesh import TriangleMesh
from facelab.models.region import RegionModel
from facelab.numeric.threads import one_thread

SUPPORT = (20.0, 60.0)
"""Distances from the middle of a component along the mesh, mm: motion nearer than the first is
free, beyond the second it costs in full."""

_RHO = 10.0  # weight of the agreement of both copies of the components
_INNER = 10  # rounds of ADMM for each round of weights


def varimax(B, rounds=200):
    """Orthonormal rows turned among themselves so that each moves few coordinates: same shape.

    Parameters
    ----------
    B : ndarray of shape (n_components, n_features)
        They span the same faces before and after, so no error of a model changes.
    rounds : int, default=200
        At most; it ends when the rows stand still.

    References
    ----------
    Kaiser 1958, The varimax criterion for analytic rotation in factor analysis.

    Examples
    --------
    >>> import numpy as np
    >>> from facelab.models import varimax
    >>> mixed = np.array([[0.8, 0.6, 0.0], [0.6, -0.8, 0.0]])
    >>> (np.abs(varimax(mixed)) > 0.01).sum(axis=1).tolist()  # coordinates that each row moves
    [1, 1]
    """
    R, before = np.eye(len(B)), 0.0
    for _ in range(rounds):
        L = B.T @ R
        U, s, Vt = np.linalg.svd(B @ (L**3 - L * (L**2).mean(axis=0)))
        R = U @ Vt
        if s.sum() <= before * (1 + 1e-9):
            break
        before = s.sum()
    return R.T @ B


def localised_model(X, mesh, n_components, sparsity=2.0, support=SUPPORT, rounds=8):
    """A whole-face model of sparse localised components: each moves the surroundings of a vertex.

    Minimises |X - W C|^2 / 2 + sum_k sum_v phi_kv |C_kv| over weights W, whose columns lie between
    -1 and 1, and components C, whose displacement at vertex v is C_kv. phi_kv rises from 0 to
    `sparsity` with the distance of v from the vertex that component k moves most. Components are
    placed one after another where most motion is left; then weights (column by column) and
    components (ADMM) are improved in turn. Coefficients of the model are least squares.

    Parameters
    ----------
    X : ndarray of shape (n_frames, 3 * n_vertices)
        Displacements from the neutral, millimetres.
    mesh : TriangleMesh
        In one piece.
    n_components : int
        Components that stay empty are left out.
    sparsity : float, default=2
        With X scaled to a standard deviation of one.
    support : (float, float)
        See `SUPPORT`.
    rounds : int, default=8
        Of weights and components.

    Returns
    -------
    RegionModel

    Raises
    ------
    ValueError
        For values that are not finite, frames that are all alike, more components than frames or
        coordinates, or a mesh in pieces.

    References
    ----------
    Neumann, Varanasi, Wenger, Wacker, Magnor, Theobalt 2013, Sparse localized deformation
    components (SIGGRAPH Asia). The paper and its program are not at hand: built from public
    descriptions of it; support in millimetres and the number of rounds are ours.

    Examples
    --------
    >>> import facelab
    >>> actor = facelab.load_registered("M1", size="small", progress=False)
    >>> motion = actor.motion("train")
    >>> model = facelab.models.localised_model(motion.displacements(), motion.mesh, 8, rounds=2)
    >>> model.n_coefficients
    8
    """
    check_type(mesh, "mesh", TriangleMesh, "give the mesh that moves")
    X = as_finite(X, "X", ("n_frames", 3 * mesh.n_vertices))
    most = min(X.shape)
    n_components = check_count(n_components, "n_components", 1, most, "components of these frames")
    check_number(sparsity, "sparsity", low=0)
    mesh.check_connected()
    rounds = check_count(rounds, "rounds", 0, None, "rounds")
    near, far = as_finite(support, "support", (2,))
    if not 0 <= near < far:
        raise ValueError(f"support={support!r}, but its distances must ascend from 0 or more, mm.")
    outside = (np.clip(mesh.geodesics(), near, far) - near) / (far - near)
    mean, scale = X.mean(axis=0), X.std()
    if not np.ptp(X, axis=0).any():
        raise ValueError("X holds still: all its frames are alike; give frames that move.")
    D = (X - mean) / scale
    with one_thread():
        W, C = _placed(D, outside, n_components)
        U = np.zeros_like(C)
        for _ in range(rounds):
            _improve_weights(D, W, C)
            middles = np.linalg.norm(C.reshape(len(C), -1, 3), axis=2).argmax(axis=1)
            C, U = _improve_components(W.T @ W, W.T @ D, C, U, sparsity * outside[middles])
    return RegionModel.from_bases(None, mean, [C[C.any(axis=1)] * scale])


def _placed(D, outside, n_components):
    """Weights and components one after another, each where most motion is left."""
    left = D.copy()
    W, C = np.zeros((len(D), n_components)), np.zeros((n_components, D.shape[1]))
    for k in range(n_components):
        v = int((left**2).sum(axis=0).reshape(-1, 3).sum(axis=1).argmax())
        U, s, _ = np.linalg.svd(left[:, 3 * v : 3 * v + 3], full_matrices=False)
        w = U[:, 0] * s[0]
        W[:, k] = w / max(np.abs(w).max(), 1e-12)
        inside = np.repeat(1 - outside[v], 3)
        C[k] = (W[:, k] @ left) / max(W[:, k] @ W[:, k], 1e-12) * inside
        left -= np.outer(W[:, k], C[k])
    return W, C


def _improve_weights(D, W, C):
    """Each column of W the best one to the others, then scaled to reach 1; in place."""
    G, P = C @ C.T, D @ C.T
    for k in np.flatnonzero(np.diagonal(G) > 1e-12):
        w = W[:, k] + (P[:, k] - W @ G[:, k]) / G[k, k]
        W[:, k] = w / max(np.abs(w).max(), 1e-12)


def _improve_components(G, P, C, U, phi):
    """Components by ADMM: least squares and shrunk displacements that are made to agree."""
    factor = cho_factor(G + _RHO * np.eye(len(G)))
    for _ in range(_INNER):
        free = cho_solve(factor, P + _RHO * (C - U))
        V = (free + U).reshape(*phi.shape, 3)
        lengths = np.linalg.norm(V, axis=2)
        keep = 1 - phi / _RHO / np.maximum(lengths, 1e-12)
        C = (V * np.maximum(keep, 0)[..., None]).reshape(free.shape)
        U = U + free - C
    return C, U
