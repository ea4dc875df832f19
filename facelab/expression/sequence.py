"""Action units over time: whole takes at once, smooth, with hidden vertices and lost frames."""

import numpy as np

from facelab.checks import check_number
from facelab.expression.units import MISALIGNED, among_all, as_basis, read_bounds
from facelab.motion import MotionSequence, WeightSequence
from facelab.numeric.least_squares import solve_bounded_chain
from facelab.numeric.threads import one_thread


def regress_sequence(
    rig, motion, lam=0.0, alpha=0.0, bounds=(0, 1), smooth=0.004, *, visible=None, align="check"
):
    """Weights over time: all frames together, the weights bound to change little.

    Minimises the sum over frames of

        ||D w_t - d_t||^2 / n + lam^2 (sum(w_t) - alpha)^2 + (smooth fps)^2 ||w_t - w_(t-1)||^2

    within bounds, exactly. Lost frames and hidden vertices have no first term; the smoothness
    carries the weights across them.

    Parameters
    ----------
    rig : BlendshapeRig or UnitBasis
    motion : MotionSequence
        On the vertices of the rig, head motion removed, millimetres.
    lam, alpha, bounds
        As for `regress_expression`, the same in every frame.
    smooth : float, default=0.004
        Millimetre seconds: a weight that changes by 1 a second costs what an error of `smooth`
        millimetres at every vertex does, whatever the frame rate.
    visible : ndarray of bool, shape (n_frames, n_vertices), optional
        False where a vertex was hidden; its positions are not looked at.
    align : {"check", False}
        Refuse motion whose frames are, in the median, moved rigidly by more than 2 mm RMS.

    Returns
    -------
    WeightSequence
        Every frame valid: lost ones are filled in.

    Raises
    ------
    ValueError
        For another vertex count, no data at all, lost frames without smoothness, or motion that
        is not aligned.
    """
    if not isinstance(motion, MotionSequence):
        raise TypeError(f"motion must be a MotionSequence, got {type(motion).__name__}.")
    basis = as_basis(rig)
    n, k, F = basis.rig.neutral.n_vertices, basis.kept, motion.n_frames
    if motion.positions.shape[1] != n:
        raise ValueError(
            f"motion has {motion.positions.shape[1]} vertices, the rig {n}; take the rig on the "
            "vertices of the motion (rig.on)."
        )
    if align not in ("check", False):
        raise ValueError(f'align={align!r} is unknown here; choose "check" or False.')
    lam, alpha = check_number(lam, "lam", low=0), check_number(alpha, "alpha")
    mu = (check_number(smooth, "smooth", low=0) * motion.fps) ** 2
    lo, hi = read_bounds(basis.rig.names, bounds)
    lo, hi = np.tile(lo[k], F), np.tile(hi[k], F)
    seen = motion.valid[:, None] if visible is None else _visible(visible, motion)
    if not seen.any():
        raise ValueError("motion has no valid frame with a visible vertex; nothing can be fitted.")
    if mu == 0 and not seen.all():
        raise ValueError("smooth=0, but vertices or frames are missing; give smooth above 0.")
    with one_thread():
        b, turn = _sequence_sides(basis, motion, seen)
        whole = seen.all(axis=1)
        if align == "check" and whole.any() and np.median(turn[whole]) > MISALIGNED:
            raise ValueError(
                f"motion is not aligned with the neutral face: its frames are moved rigidly by "
                f"{np.median(turn[whole]):.1f} mm RMS (median; allowed: {MISALIGNED:g}) beyond "
                "what units explain; take out the head motion, or pass align=False."
            )
        H = _sequence_grams(basis, seen) + lam**2
        g = (b + lam**2 * alpha).ravel()
        w = solve_bounded_chain(H, g, mu, lo, hi, F)
    return WeightSequence(among_all(w.reshape(F, -1), basis), basis.rig.names, motion.fps)


def _visible(visible, motion):
    visible = np.asarray(visible)
    if visible.shape != motion.positions.shape[:2] or visible.dtype != bool:
        raise ValueError(
            f"visible has shape {visible.shape} and type {visible.dtype}, but needs one bool for "
            f"each of {motion.positions.shape[:2]} frames and vertices."
        )
    return visible & motion.valid[:, None]


def _sequence_sides(basis, motion, seen, chunk=64):
    """D^T d_t / n, (F, n_kept), and the rigid motion of every frame, (F,), millimetres RMS."""
    N, n = basis.rig.neutral.vertices, basis.rig.neutral.n_vertices
    V = N - N.mean(axis=0)
    spread = V.T @ V / n
    b, turn = [], []
    for start in range(0, motion.n_frames, chunk):
        part = slice(start, start + chunk)
        d = np.where(seen[part, :, None], motion.positions[part] - N, 0).reshape(-1, 3 * n)
        b.append(d @ basis.Q @ basis.R / n)
        x = d @ basis.rigid.T
        r, t = x[:, :3], x[:, 3:]
        # mean |r x v + t|^2 over centred v
        size = (r**2).sum(axis=1) * np.trace(spread) - ((r @ spread) * r).sum(axis=1)
        turn.append(np.sqrt(np.maximum(size, 0) + (t**2).sum(axis=1)))
    return np.concatenate(b), np.concatenate(turn)


def _sequence_grams(basis, seen):
    """D^T D / n over the visible vertices: (1, k, k) if all are the same, (F, k, k) else."""
    n = basis.rig.neutral.n_vertices
    if seen.all():
        return basis.gram[None] / n
    if seen.shape[1] == 1:
        return seen[:, :, None] * basis.gram / n
    D = np.asarray(basis.rig.deltas[basis.kept], dtype=float).transpose(1, 2, 0)
    known, grams = {}, []
    for mask in seen:
        key = mask.tobytes()
        if key not in known:
            few = mask if mask.sum() < n / 2 else ~mask
            part = D[few].reshape(-1, D.shape[2])
            G = part.T @ part
            known[key] = (G if few is mask else basis.gram - G) / n
        grams.append(known[key])
    return np.stack(grams)
