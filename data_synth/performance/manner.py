"""An actor's own manner, laid over what is performed: strength, asymmetry, coupling of units."""

import numpy as np

from data_synth.actors import ACTORS, actor_number
from data_synth.performance.tracks import columns
from data_synth.units import UNITS, expand
from facelab.checks import check_choice


def manner_matrix(actor):
    """Strength, asymmetry and coupling of an actor's units as one matrix.

    Parameters
    ----------
    actor : str
        One of `data_synth.actors.ACTORS`.

    Returns
    -------
    A : ndarray of shape (40, 40)
        A[i, j] is how much unit j moves when unit i is wanted; the diagonal holds the strengths.
        All within [0, 1].
    """
    check_choice(actor, "actor", tuple(ACTORS))
    manner = ACTORS[actor].manner
    strength = np.full(len(UNITS), manner.strength)
    for name, gain in manner.gains.items():
        strength[columns(name)] = gain
    # lids must close, jaw and lips must do what speech asks
    strength[columns("AU45")] = 1.0
    one = np.random.default_rng(700 + actor_number(actor)).uniform(0.94, 1.0, len(UNITS))
    strength *= np.where(np.isin(UNITS, expand("AU45")), 1.0, one)
    weak = [k for k, name in enumerate(UNITS) if name[-1] == manner.weak_side and "45" not in name]
    strength[weak] *= 1 - manner.asymmetry
    A = np.diag(strength)
    for (cause, effect), share in manner.couplings.items():
        for i in columns(cause):
            for j in columns(effect):
                opposite = {UNITS[i][-1], UNITS[j][-1]} == {"L", "R"}
                A[i, j] = max(A[i, j], 0.0 if opposite else share)
    return A


def apply_manner(weights, actor):
    """Weights as an actor performs them: shape (n_frames, 40), within [0, 1] like those given.

    Contributions join as chances do, 1 - prod(1 - A[i, j] w[i]): they add up while small and
    never exceed 1.
    """
    A = manner_matrix(actor)
    rest = np.ones_like(weights)
    for i in range(len(UNITS)):
        to = np.flatnonzero(A[i])
        rest[:, to] *= 1 - A[i, to] * weights[:, i : i + 1]
    return 1 - rest
