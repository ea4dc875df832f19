"""The formulas of Yu and Liu 2014 as they are printed: plain and slow.

Written from the paper, not from the package. D is (3 n, N), one action unit d_i per column; d is
the sketch minus the neutral, (3 n,).
"""

import numpy as np
from scipy.optimize import lsq_linear


def blend(S_0, w, deltas):
    """Eq. 1."""
    S = S_0.copy()
    for w_i, d_i in zip(w, deltas, strict=True):
        S = S + w_i * d_i
    return S


def least_squares(D, d):
    """Eq. 5."""
    return np.linalg.inv(D.T @ D) @ D.T @ d


def objective(w, D, d, lam, alpha):
    """Eq. 9."""
    return ((D @ w - d) ** 2).sum() + lam**2 * (w.sum() - alpha) ** 2


def regress(D, d, lam, alpha, bounds, method="trf"):
    """Eq. 9 on the full matrix, by the reflective Newton method (trf) or another of SciPy's."""
    A = np.vstack([D, lam * np.ones(D.shape[1])])
    return lsq_linear(
        A, np.append(d, lam * alpha), bounds, method=method, tol=1e-15, lsq_solver="exact"
    ).x


def e_rms(S_hat, S):
    """Eq. 10."""
    total = 0.0
    for a, b in zip(S_hat, S, strict=True):
        total += np.linalg.norm(a - b) ** 2
    return np.sqrt(total) / len(S)


def laplacian(n, faces):
    """Eq. 11 with the same weight for each neighbour."""
    L = np.eye(n)
    for i in range(n):
        near = {int(j) for f in faces if i in f for j in f} - {i}
        for j in near:
            L[i, j] = -1 / len(near)
    return L


def deform(L, V, anchors, positions, alpha):
    """Eq. 13 to 15, with the optimised positions as anchors (Eq. 14 prints the neutral's)."""
    m, n = len(anchors), len(V)
    pick = np.zeros((m, n))
    pick[np.arange(m), anchors] = 1
    A = np.vstack([L, alpha * pick])
    b = np.vstack([L @ V, alpha * positions])
    return np.linalg.inv(A.T @ A) @ A.T @ b
