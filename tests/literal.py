"""The formulas of Tena et al. 2011 as they are printed: plain, slow, in loops.

Written from the paper, not from the package. A region model is a list `members` (vertices of
region i, ascending) and a list `bases` (B^i of shape (3 N^i, P^i), one mode per column, as in the
paper). A shape v is (N, 3). Coefficients `c` are a list of c^i.
"""

import numpy as np


def correlation(positions):
    """Section 4.2: normalised correlation matrices of x, y and z, averaged; 0 for what is still."""
    _, n, _ = positions.shape
    C_bar = np.zeros((n, n))
    for p in range(n):
        for q in range(n):
            for axis in range(3):
                a = positions[:, p, axis] - positions[:, p, axis].mean()
                b = positions[:, q, axis] - positions[:, q, axis].mean()
                size = np.sqrt((a @ a) * (b @ b))
                C_bar[p, q] += (a @ b / size if size > 0 else 0) / 3
    return C_bar


def affinity(C_bar, G, lam, r, threshold):
    """Eq. 11 and 12, the correlation thresholded before."""
    n = len(G)
    A = np.zeros((n, n))
    for p in range(n):
        for q in range(n):
            C_pq = C_bar[p, q] if C_bar[p, q] >= threshold else 0
            G_bar_pq = np.exp(-G[p, q] / r)  # Eq. 11
            A[p, q] = lam * C_pq + (1 - lam) * G_bar_pq  # Eq. 12
    return A


def ng_jordan_weiss(A, k):
    """Ng, Jordan and Weiss 2001, steps 1 to 4; columns in order of falling eigenvalue."""
    n = len(A)
    A = A.copy()
    for p in range(n):
        A[p, p] = 0  # step 1
    D = np.diag(A.sum(axis=1))
    D_root = np.linalg.inv(np.sqrt(D))
    L = D_root @ A @ D_root  # step 2
    values, vectors = np.linalg.eigh(L)
    X = vectors[:, np.argsort(-values)[:k]]  # step 3
    return np.array([row / np.linalg.norm(row) for row in X])  # step 4


def members(labels, faces, sharing):
    """Vertices of each region: its own, and the ends of crossing edges by the rule of sharing."""
    held = [set(np.flatnonzero(labels == i).tolist()) for i in range(labels.max() + 1)]
    for face in faces.tolist():
        for p in face:
            for q in face:
                i, j = labels[p], labels[q]
                if sharing == "both" and i != j:
                    held[j].add(p)
                if sharing == "one-sided" and i < j:  # the end in i belongs to the later j too
                    held[j].add(p)
    return [np.array(sorted(h)) for h in held]


def rows_of(vertices, wanted):
    """Rows of B^i that belong to some vertices of region i, in the order wanted."""
    vertices = list(vertices)
    return [3 * vertices.index(v) + axis for v in wanted for axis in range(3)]


def boundary(members, bases, i, j):
    """B_j^i: the rows of B^i for the vertices that regions i and j share."""
    shared = [v for v in members[i] if v in set(members[j].tolist())]
    return bases[i][rows_of(members[i], shared)]


def split(zeta, bases):
    """zeta = [c^1; c^2; ...; c^M] taken apart."""
    ends = np.cumsum([B.shape[1] for B in bases])
    return np.split(zeta, ends[:-1])


def eq_4(v, B):
    """Coefficients of one shape in one basis."""
    return np.linalg.inv(B.T @ B) @ B.T @ v


def boundary_term(members, bases, c):
    """The double sum of Eq. 6 and 9 without beta; j = i adds nothing."""
    E = 0.0
    for i in range(len(bases)):
        for j in range(i, len(bases)):
            if i != j:
                gap = boundary(members, bases, i, j) @ c[i] - boundary(members, bases, j, i) @ c[j]
                E += gap @ gap
    return E


def eq_6(v, members, bases, c, beta):
    """Energy of a shape in a region model; Eq. 5 at beta = 0."""
    E = 0.0
    for i, B in enumerate(bases):
        E += np.sum((v[members[i]].ravel() - B @ c[i]) ** 2)
    return E + beta * boundary_term(members, bases, c)


def eq_7(v, members, bases, c, beta):
    """Half the gradient of Eq. 6, with B_i^j in the last term as in Eq. 10."""
    gradient = []
    for i, B in enumerate(bases):
        g = B.T @ B @ c[i] - B.T @ v[members[i]].ravel()
        for j in range(len(bases)):
            if j != i:
                B_ij, B_ji = boundary(members, bases, i, j), boundary(members, bases, j, i)
                g = g + beta * (B_ij.T @ B_ij @ c[i] - B_ij.T @ B_ji @ c[j])
        gradient.append(g)
    return np.concatenate(gradient)


def eq_6_stacked(v, members, bases, beta):
    """Matrix and right side whose least squares are Eq. 6: one block of rows for each norm."""
    P = [B.shape[1] for B in bases]
    at = np.concatenate([[0], np.cumsum(P)])
    rows, rhs = [], []
    for i, B in enumerate(bases):
        block = np.zeros((B.shape[0], at[-1]))
        block[:, at[i] : at[i + 1]] = B
        rows.append(block)
        rhs.append(v[members[i]].ravel())
        for j in range(i + 1, len(bases)):
            B_ij, B_ji = boundary(members, bases, i, j), boundary(members, bases, j, i)
            block = np.zeros((len(B_ij), at[-1]))
            block[:, at[i] : at[i + 1]] = B_ij
            block[:, at[j] : at[j + 1]] = -B_ji
            rows.append(np.sqrt(beta) * block)
            rhs.append(np.zeros(len(B_ij)))
    return np.vstack(rows), np.concatenate(rhs)


def eq_9(pins, members, bases, c, c_0, beta, gamma):
    """Energy of pins {vertex k: v_k}; Eq. 8 where there is one region."""
    E = 0.0
    for i, B in enumerate(bases):
        for k, v_k in pins.items():
            if k in members[i]:
                B_k = B[rows_of(members[i], [k])]
                E += np.sum((v_k - B_k @ c[i]) ** 2)
    E += beta * boundary_term(members, bases, c)
    for i in range(len(bases)):
        E += gamma * np.sum((c_0[i] - c[i]) ** 2)
    return E


def eq_10(pins, members, bases, c_0, beta, gamma):
    """zeta where the gradient of Eq. 9 vanishes: the system put together block by block."""
    P = [B.shape[1] for B in bases]
    at = np.concatenate([[0], np.cumsum(P)])
    S = np.zeros((at[-1], at[-1]))
    rhs = np.zeros(at[-1])
    for i, B in enumerate(bases):
        s_i = slice(at[i], at[i + 1])
        for k, v_k in pins.items():
            if k in members[i]:
                B_k = B[rows_of(members[i], [k])]
                S[s_i, s_i] += B_k.T @ B_k
                rhs[s_i] += B_k.T @ v_k
        for j in range(len(bases)):
            if j != i:
                B_ij, B_ji = boundary(members, bases, i, j), boundary(members, bases, j, i)
                S[s_i, s_i] += beta * B_ij.T @ B_ij
                S[s_i, at[j] : at[j + 1]] -= beta * B_ij.T @ B_ji
        S[s_i, s_i] += gamma * np.eye(P[i])
        rhs[s_i] += gamma * c_0[i]
    return np.linalg.solve(S, rhs)


def blend(members, bases, c, n_vertices):
    """Section 3.1: the mean value of a vertex over the regions that share it."""
    v = np.zeros((n_vertices, 3))
    for p in range(n_vertices):
        copies = []
        for i, B in enumerate(bases):
            if p in members[i]:
                copies.append(B[rows_of(members[i], [p])] @ c[i])
        v[p] = np.mean(copies, axis=0)
    return v


def eq_13(X, X_hat):
    """E_RMS of frames of shape (F, N, 3)."""
    F, N, _ = X.shape
    total = 0.0
    for i in range(F):
        total += np.sum((X[i] - X_hat[i]) ** 2) / N
    return np.sqrt(total / F)
