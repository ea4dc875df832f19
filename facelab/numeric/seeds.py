"""Seeds of chance, as both kinds of generators of NumPy take them."""

import numpy as np

_MOST = 2**32 - 1


def as_generator(random_state):
    """A Generator of a seed, of either kind of generator, or of None (another each time).

    Raises
    ------
    TypeError, ValueError
        For what is none of these, or an integer outside 0 to 2**32 - 1.

    Examples
    --------
    >>> as_generator(3).integers(100) == as_generator(3).integers(100)
    True
    """
    if isinstance(random_state, np.random.RandomState):
        random_state = random_state.randint(2**31 - 1)
    return np.random.default_rng(_checked(random_state))


def as_random_state(random_state):
    """A RandomState of the same, for what scikit-learn does: see `as_generator`."""
    if isinstance(random_state, np.random.RandomState):
        return random_state
    if isinstance(random_state, np.random.Generator):
        random_state = int(random_state.integers(_MOST))
    return np.random.RandomState(_checked(random_state))


def _checked(seed):
    if seed is None or isinstance(seed, np.random.Generator):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)):
        raise TypeError(
            f"random_state={seed!r} is no seed: give an integer, a generator of NumPy, or None."
        )
    if not 0 <= seed <= _MOST:
        raise ValueError(f"random_state={seed}, but a seed must be 0 or more and {_MOST} or less.")
    return int(seed)
