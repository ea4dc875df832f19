"""What a `BoundedPull` says, solved by a general minimiser."""

import numpy as np
from scipy.optimize import minimize


def target_in(pull, target):
    """The target (3,), brought back into the ball of the pull."""
    if pull.centre is None:
        return target
    off = target - pull.centre
    return pull.centre + off * min(1, pull.radius / np.linalg.norm(off))


def moved(pull, t):
    """Displacements of a face under a pull t (3,), by a general minimiser of what it says."""
    f = pull.free + pull.slope @ t
    A = np.linalg.inv(pull.inverse)
    hard = pull.give == 0
    stiff = np.where(hard, 0, 1 / np.where(hard, 1, pull.give))

    def energy(c):
        beyond = c - c.clip(pull.lo, pull.hi)
        return (c - f) @ A @ (c - f) / 2 + stiff @ beyond**2 / 2, A @ (c - f) + stiff * beyond

    ends = zip(pull.lo, pull.hi, hard, strict=True)
    ends = [(lo, hi) if h else (None, None) for lo, hi, h in ends]
    tight = {"ftol": 0, "gtol": 1e-12, "maxiter": 10_000, "maxfun": 100_000, "maxcor": 50}
    c = minimize(energy, pull.start, jac=True, bounds=ends, method="L-BFGS-B", options=tight).x
    by = np.tensordot(c - pull.start, pull.basis.rows, 1)
    return by if pull.basis.weights is None else pull.basis.weights @ by
