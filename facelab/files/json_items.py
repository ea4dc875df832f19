"""JSON from strangers: every value is asked for by kind, and refused with its place."""

import json
import math
import warnings

from facelab.files.words import damaged


def load_json(data, path, what):
    """The object in some bytes of JSON, as an `Item`.

    Parameters
    ----------
    data : bytes
    path : Path
        For messages.
    what : str
        What it should be ("glTF file").

    Raises
    ------
    ValueError
        If it is no JSON, is nested too deep, has a key twice, or is no object.
    """
    try:
        value = json.loads(
            data.decode("utf-8-sig"), object_pairs_hook=_once, parse_constant=_no_number
        )
    except _Wrong as error:
        raise ValueError(f"{path}: not a readable {what}: {error}.") from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: not a readable {what}: byte {error.start} of its JSON is no UTF-8 text."
        ) from None
    except json.JSONDecodeError as error:
        raise ValueError(
            f"{path}: not a readable {what}: its JSON breaks off or is damaged in line "
            f"{error.lineno}, column {error.colno}."
        ) from None
    except (RecursionError, ValueError):  # the latter for numbers of thousands of digits
        raise ValueError(
            f"{path}: not a readable {what}: its JSON is nested too deep or holds numbers that are "
            "none."
        ) from None
    if not isinstance(value, dict):
        raise ValueError(f"{path}: not a readable {what}: its JSON is no object.")
    return Item(value, path, "")


class _Wrong(Exception):
    pass


def _once(pairs):
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise _Wrong(f"the key {twice!r} is in one object twice")
    return found


def _no_number(text):
    raise _Wrong(f"{text} is no number")


class Item:
    """An object of a JSON file, with its place: `accessors[3]`."""

    def __init__(self, value, path, place):
        self.value, self.path, self.place = value, path, place

    def __contains__(self, key):
        return key in self.value

    def at(self, key):
        """The place of a value, for messages."""
        return f"{self.place}.{key}" if self.place else key

    def wrong(self, key, wanted):
        """The error for a value that is not as it should be."""
        found = repr(self.value[key])[:60] if key in self.value else "missing"
        return ValueError(f"{self.path}: {self.at(key)} is {found}, but must be {wanted}.")

    def damaged(self, what, key=None):
        """The error for an object, or a value in it, that contradicts the rest of the file."""
        return damaged(f"{self.path}: {self.place if key is None else self.at(key)} {what}")

    def whole(self, key, default=None, low=0, high=None):
        """A whole number from `low` to `high`; the default where it is missing, if there is one."""
        value = self.value.get(key, default)
        if key not in self.value and default is not None:
            return value
        wanted = f"{low} or more" if high is None else f"{low} to {high}"
        wanted = "one of none" if high is not None and high < low else wanted
        if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
            value = int(value)
        is_whole = isinstance(value, int) and not isinstance(value, bool)
        if not is_whole or not low <= value < 2**53 or (high is not None and value > high):
            raise self.wrong(key, f"a whole number, {wanted}")
        return value

    def index(self, key, of):
        """A whole number that counts the items of a list of the file."""
        return self.whole(key, high=len(of) - 1)

    def _of(self, kind, key, default, wanted):
        value = self.value.get(key, default)
        if value is not default and not isinstance(value, kind):
            raise self.wrong(key, wanted)
        return value

    def flag(self, key):
        """True or false; false where it is missing."""
        return self._of(bool, key, False, "true or false")

    def text(self, key, default=None):
        """A text; the default where it is missing."""
        return self._of(str, key, default, "a text")

    def numbers(self, key, count=None, default=None):
        """A list of `count` finite numbers; the default where it is missing."""
        value = self.value.get(key, default)
        if key not in self.value:
            return value
        good = isinstance(value, list) and (count is None or len(value) == count)
        if not good or not all(_is_number(v) for v in value):
            raise self.wrong(key, f"a list of {'' if count is None else f'{count} '}numbers")
        return [float(v) for v in value]

    def texts(self, key):
        """A list of texts, empty where it is missing."""
        value = self._of(list, key, [], "a list of texts")
        if not all(isinstance(v, str) for v in value):
            raise self.wrong(key, "a list of texts")
        return value

    def listed(self, key, wanted):
        """A list as an object whose keys are places; empty where it is missing."""
        value = self._of(list, key, [], wanted)
        return Item(dict(enumerate(value)), self.path, self.at(key))

    def wholes(self, key, of=None):
        """A list of whole numbers from 0 up, below the length of `of`; empty where missing."""
        listed = self.listed(key, "a list of whole numbers")
        return [listed.whole(k, high=None if of is None else len(of) - 1) for k in listed.value]

    def item(self, key):
        """An object within; empty where it is missing."""
        return Item(self._of(dict, key, {}, "an object"), self.path, self.at(key))

    def items(self, key):
        """A list of objects within, empty where it is missing."""
        value = self._of(list, key, [], "a list of objects")
        if not all(isinstance(v, dict) for v in value):
            raise self.wrong(key, "a list of objects")
        return [Item(v, self.path, f"{self.at(key)}[{k}]") for k, v in enumerate(value)]

    def warn_unknown(self, known):
        """Warn of keys that the format does not have here: a slip of the pen changes the mesh."""
        odd = sorted(set(self.value) - set(known) - {"extensions", "extras"})
        if odd:
            warnings.warn(
                f"{self.path}: {self.place or 'the file'} has {', '.join(map(repr, odd[:4]))}, "
                "which glTF does not know; it is passed over.",
                stacklevel=2,
            )


def _is_number(value):
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond what a float holds
        return False
