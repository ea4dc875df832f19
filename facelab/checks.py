"""Checks at the boundary: one wording for what was wrong, where, and what to do."""

from collections import Counter
from collections.abc import Iterable

import numpy as np


def as_finite(array, name, shape, where="", remedy="remove or repair the bad values"):
    """The array as float64, refused unless it has the shape asked for and only finite numbers.

    Texts and truth values are no numbers, even where they could be taken for some.

    Parameters
    ----------
    array : array_like
    name : str
        Name of the parameter, for the message.
    shape : tuple of (int or str)
        Wanted shape; a string stands for any length and names it.
    where : str
        Place of the data, for the message ("face.obj").
    remedy : str
        What to do about numbers that are not finite.

    Raises
    ------
    TypeError, ValueError
        Naming the parameter, what was given and what is wanted.
    """
    place = f" in {where}" if where else ""
    wanted = "(" + ", ".join(str(s) for s in shape) + ("," if len(shape) == 1 else "") + ")"
    array = as_numbers(array, f"{name}{place}", wanted, remedy)
    fits = [
        isinstance(want, str) or want == have
        for want, have in zip(shape, array.shape, strict=False)
    ]
    if array.ndim != len(shape) or not all(fits):
        raise ValueError(f"{name}{place} has shape {array.shape}, but needs shape {wanted}.")
    bad = ~np.isfinite(array)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        raise ValueError(
            f"{name}{place} holds {int(bad.sum())} value(s) that are NaN or infinite, the first at "
            f"index {first}; {remedy}."
        )
    return array


def as_numbers(array, name, wanted, remedy="remove or repair the bad values"):
    """The array as float64 of any shape, refused if it holds anything but numbers.

    Parameters
    ----------
    array, name, remedy
        As for `as_finite`.
    wanted : str
        The shape that it should have, for the message.
    """
    refuse_mask(array, name, remedy)
    try:
        if not _numeric(array):
            raise TypeError
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError):
        raise TypeError(
            f"{name} is a {type(array).__name__} that makes no array of numbers; give numbers of "
            f"shape {wanted}."
        ) from None
    except OverflowError:
        raise ValueError(f"{name} holds an integer beyond all floats; {remedy}.") from None


def as_floats(array, name, wanted, remedy="remove or repair the bad values"):
    """As `as_numbers`, but floats stay as they are: in single precision, or mapped from a file."""
    if isinstance(array, np.ndarray) and array.dtype.kind == "f":
        refuse_mask(array, name, remedy)
        return np.asarray(array)
    return as_numbers(array, name, wanted, remedy)


def check_names(names):
    """The names as a tuple, refused unless they are texts, each once."""
    if not isinstance(names, Iterable):
        raise TypeError(f"names={names!r} is no list of texts; give a name for each.")
    names = tuple(names)
    other = [repr(name) for name in names if not isinstance(name, str)]
    if other:
        raise TypeError(
            f"names holds {', '.join(other[:6])}, no texts; give them as texts: map(str, names)."
        )
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise ValueError(f"names holds {', '.join(twice)} more than once; each needs its own.")
    return names


def _numeric(value):
    """Whether nothing in a value is text, a truth value, complex or masked."""
    if isinstance(value, (list, tuple)):
        return all(map(_numeric, value))
    if value is np.ma.masked:
        return False
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "iuf" or (value.dtype == object and _numeric(value.tolist()))
    return not isinstance(value, (str, bytes, bool, np.bool_, complex))


def refuse_mask(array, name, remedy):
    """Refuse a masked array that hides values: as a plain array it would show them."""
    hidden = np.ma.count_masked(array) if isinstance(array, np.ma.MaskedArray) else 0
    if hidden:
        raise ValueError(f"{name} is a masked array that hides {hidden} value(s); {remedy}.")


def check_type(value, name, types, remedy):
    """The value, refused unless it is of the type, or of one of a tuple of types."""
    if not isinstance(value, types):
        names = [t.__name__ for t in (types if isinstance(types, tuple) else (types,))]
        raise TypeError(
            f"{name} is a {type(value).__name__}, but must be of type {' or '.join(names)}; "
            f"{remedy}."
        )
    return value


def check_number(value, name, low=None, high=None, above=None):
    """The value as float, refused unless finite and within [low, high] (or above `above`).

    Texts and truth values are no numbers, even where they could be taken for some.
    """
    try:
        if not _numeric(value):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name}={value!r} is not a number.") from None
    except OverflowError:
        raise ValueError(f"{name} is an integer beyond all floats; give a smaller one.") from None
    wanted = ["finite"] * (not np.isfinite(number))
    wanted += [f"{low} or more"] * (low is not None) + [f"{high} or less"] * (high is not None)
    wanted += [f"more than {above}"] * (above is not None)
    if (
        not np.isfinite(number)
        or (low is not None and number < low)
        or (high is not None and number > high)
        or (above is not None and number <= above)
    ):
        raise ValueError(f"{name}={value!r}, but it must be {' and '.join(wanted)}.")
    return number


def check_index(value, name, size, what):
    """The value as int, refused unless it is one of the `size` indices of `what`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}={value!r} is not an integer: give the index of one of {what}.")
    if not 0 <= value < size:
        raise ValueError(f"{name}={value}, but there are {size} {what}: 0 to {size - 1}.")
    return int(value)


def check_count(value, name, low, high, what):
    """The value as int, refused unless it counts `low` to `high` (None: any number) of `what`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}={value!r} is not an integer: give the number of {what}.")
    if value < low or (high is not None and value > high):
        wanted = f"{low} or more" if high is None else f"{low} to {high}"
        raise ValueError(f"{name}={value}, but the number of {what} must be {wanted}.")
    return int(value)


def as_indices(values, name, size, what, distinct=True):
    """Indices of `what`, each once, as an int array; refused if one is outside 0 to size - 1."""
    array = np.atleast_1d(np.asarray(values))
    array = array.astype(int) if array.size == 0 else array
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise TypeError(
            f"{name} has shape {array.shape} and type {array.dtype}; give a list of integers, the "
            f"indices of {what}."
        )
    out = array[(array < 0) | (array >= size)]
    if out.size:
        raise ValueError(
            f"{name} holds {', '.join(map(str, out[:6].tolist()))}, but there are {size} {what}: "
            f"0 to {size - 1}."
        )
    once, count = np.unique(array, return_counts=True)
    if distinct and (count > 1).any():
        twice = ", ".join(map(str, once[count > 1][:6].tolist()))
        raise ValueError(f"{name} holds {twice} more than once; give each index once.")
    return array.astype(int)


def check_choice(value, name, choices):
    """The choice that the value equals, refused if there is none."""
    for choice in choices:
        if np.ndim(value) == 0 and value == choice:
            return choice
    raise ValueError(f"{name}={value!r} is unknown; choose one of {', '.join(map(repr, choices))}.")
