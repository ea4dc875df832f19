"""Small bounded least squares, solved exactly: one, a chain of frames, or a whole path.

H is (K, K), symmetric positive definite; g, lo and hi are (K,). Everything minimises
w' H w / 2 - g' w with lo <= w <= hi.
"""

import numpy as np
from scipy.fft import dct, idct
from scipy.linalg import cho_solve_banded, cholesky_banded


def pivot(solve, times, g, lo, hi, at=None):
    """Minimise w' H w / 2 - g' w with lo <= w <= hi by block principal pivoting, exactly.

    All variables on the wrong side change sides at once; if their number has not fallen for ten
    rounds, only the last of them does (Murty's rule, which must end).

    Parameters
    ----------
    solve : callable (free, w) -> w
        Fills in w where free, the rest held: H_ff w_f = g_f - H_fb w_b.
    times : callable w -> H w
        H is symmetric positive definite.
    at : ndarray of int, shape (n,), optional
        Side to start from: -1 at lo, 1 at hi, 0 free.

    Returns
    -------
    w, at : ndarray of shape (n,)
    """
    fixed = lo == hi
    at = np.where(fixed, -1, 0 if at is None else at)
    slack = 1e-12 * np.abs(g).max(initial=0) + 1e-15
    fewest, patience = len(g) + 1, 10
    for _ in range(200 + 50 * len(g)):
        w = solve(at == 0, np.where(at < 0, lo, np.where(at > 0, hi, 0.0)))
        y = times(w) - g  # gradient: 0 where free, not negative at lo, not positive at hi (KKT)
        below = (at == 0) & (w < lo - 1e-12)
        above = (at == 0) & (w > hi + 1e-12)
        wrong = below | above | ((at * y > slack) & ~fixed)
        count = np.count_nonzero(wrong)
        if not count:
            return w.clip(lo, hi), at
        if count < fewest:
            fewest, patience = count, 10
        elif patience:
            patience -= 1
        else:
            wrong &= np.arange(len(g)) == np.flatnonzero(wrong)[-1]
        at[wrong] = np.where(below, -1, np.where(above, 1, 0))[wrong]
    raise np.linalg.LinAlgError("pivoting did not end: H is not positive definite")


def solve_bounded(H, g, lo, hi, at=None):
    """`pivot` with a dense H of shape (K, K)."""

    def solve(free, w):
        f = np.flatnonzero(free)
        w[f] = np.linalg.solve(H[np.ix_(f, f)], g[f] - H[f] @ w)  # w[f] is 0 on the right
        return w

    return pivot(solve, lambda w: H @ w, g, lo, hi, at)


def bounded_path(H, g, pull, lo, hi, start, stop):
    """All w(alpha) = argmin w' H w / 2 - (g + alpha pull)' w within bounds: its knots.

    Between knots the same units are free and w is linear in alpha. At a knot one unit reaches a
    bound or leaves it, and the inverse of the free block is updated by one rank.

    Returns
    -------
    knots : ndarray of shape (n_knots,)
        From start to stop, ascending.
    W : ndarray of shape (n_knots, K)
    """
    fixed, alpha = lo == hi, start
    w, at = solve_bounded(H, g + alpha * pull, lo, hi)
    M = _free_inverse(H, at)
    w = w + M @ (g + alpha * pull - H @ w)
    y = H @ w - g - alpha * pull
    knots, W, stuck = [alpha], [w], 0
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(200 + 50 * len(g)):
            # dw / dalpha where free: H_ff w_f' = pull_f; dy / dalpha of the gradient at the bounds
            free, w_rate = at == 0, M @ pull
            y_rate = H @ w_rate - pull
            to_bound = (np.where(w_rate > 0, hi, lo) - w) / w_rate
            ahead = np.where(free, to_bound, -y / y_rate)
            moving = np.where(free, np.abs(w_rate), at * y_rate) > 1e-14
            ahead[~moving | fixed] = np.inf
            k = int(ahead.argmin())
            step = max(float(ahead[k]), 0.0)
            if alpha + step >= stop:
                w = w + (stop - alpha) * w_rate
                knots.append(stop)
                W.append(w + M @ (g + stop * pull - H @ w))
                return np.array(knots), np.array(W).clip(lo, hi)
            alpha += step
            w = w + step * w_rate
            stuck = 0 if step > 1e-12 * (1 + abs(alpha)) else stuck + 1
            if free[k]:
                at[k] = 1 if w_rate[k] > 0 else -1
                w[k] = hi[k] if w_rate[k] > 0 else lo[k]
                # the inverse of a block without row and column k (Schur complement)
                M -= M[:, k, None] * (M[k] / M[k, k])
                M[k], M[:, k] = 0, 0
            y = H @ w - g - alpha * pull
            w = w - M @ y  # takes out rounding: M is 0 beyond the free
            if not free[k]:
                at[k] = 0
                v = M @ H[k]  # and with them again
                left = H[k, k] - H[k] @ v
                v[k] = -1
                M += v[:, None] * (v / left)
            if stuck > 2 * len(g):  # tied units change sides in circles: start afresh just beyond
                alpha += 1e-9 * (1 + abs(alpha))
                w, at = solve_bounded(H, g + alpha * pull, lo, hi, at)
                M, y, stuck = _free_inverse(H, at), H @ w - g - alpha * pull, 0
            elif len(knots) % 32 == 0:
                M = _free_inverse(H, at)
            knots.append(alpha)
            W.append(w)
    raise np.linalg.LinAlgError("the path over alpha did not end")


def _free_inverse(H, at):
    M, f = np.zeros_like(H), np.flatnonzero(at == 0)
    M[np.ix_(f, f)] = np.linalg.inv(H[np.ix_(f, f)])
    return M


def along_path(knots, W, alphas):
    """The path at any alphas: linear between knots."""
    k = np.clip(np.searchsorted(knots, alphas, side="right") - 1, 0, len(knots) - 2)
    length = knots[k + 1] - knots[k]
    share = (alphas - knots[k]) / np.where(length > 0, length, 1)
    return W[k] + share[:, None] * (W[k + 1] - W[k])


def weights_over(H, g, pull, lo, hi, alphas):
    """Knots, their weights, and the weights at the alphas."""
    knots, W = bounded_path(H, g, pull, lo, hi, alphas.min(), alphas.max())
    return knots, W, along_path(knots, W, alphas)


def kkt_residual(H, b, pull, lo, hi, alphas, w):
    """Largest violation of the optimality conditions at each alpha, relative to max |b|."""
    y = w @ H - b - alphas[:, None] * pull
    off = np.where(w <= lo, np.minimum(y, 0), np.where(w >= hi, np.maximum(y, 0), y))
    off = np.where(lo == hi, 0, off)
    return np.abs(off).max(axis=1) / (np.abs(b).max() or 1)


def solve_bounded_chain(H, g, mu, lo, hi, F):
    """`pivot` for frames in a row: block-tridiagonal, factored as a band of width K."""
    k = H.shape[-1]
    ends = np.full(F, 2.0 * mu)
    ends[[0, -1]] -= mu
    ab = np.zeros((k + 1, F, k))
    for i in range(k):
        ab[i, :, : k - i] = np.diagonal(H, i, axis1=1, axis2=2)
    ab[0] += ends[:, None]
    ab[k, : F - 1] = -mu
    ab = ab.reshape(k + 1, -1)

    def times(w):
        W = w.reshape(F, k)
        y = W @ H[0] if len(H) == 1 else (H @ W[..., None])[..., 0]
        y = y + ends[:, None] * W
        y[1:] -= mu * W[:-1]
        y[:-1] -= mu * W[1:]
        return y.ravel()

    def solve(free, w):
        band = ab * free
        for i in range(1, k + 1):
            band[i, :-i] *= free[i:]
        band[0] += ~free
        factor = (cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False), True)
        for _ in range(2):
            w = w + cho_solve_banded(factor, np.where(free, g - times(w), 0), check_finite=False)
        return w

    return pivot(solve, times, g, lo, hi)[0]


def solve_bounded_rows(H, G, lo, hi):
    """`solve_bounded` for each row of G, (F, K), each from where the one before it ended."""
    W, at = np.zeros_like(G), None
    for w, g in zip(W, G, strict=True):
        w[:], at = solve_bounded(H, g, lo, hi, at)
    return W


def smoothed_sides(H, G, mu):
    """Right sides g_t of frames in a row, smoothed in time.

    They are H w_t for the w that minimise, without bounds, the sum over frames of
    w_t' H w_t / 2 - g_t' w_t + mu |w_t - w_(t-1)|^2 / 2.

    A frame solved within bounds from such a side is that w_t brought into them the shortest way,
    as H measures it: frames that are near each other stay at least as near.

    Parameters
    ----------
    G : ndarray of shape (F, K)

    Returns
    -------
    ndarray of shape (F, K)
    """
    values, U = np.linalg.eigh(H)
    values = values.clip(1e-12 * values[-1])
    # second differences in time are diagonal along cosines, H along its eigenvectors
    pace = 2 - 2 * np.cos(np.pi * np.arange(len(G)) / len(G))
    share = values / (values + mu * pace[:, None])
    return idct(share * dct(G @ U, axis=0, norm="ortho"), axis=0, norm="ortho") @ U.T
