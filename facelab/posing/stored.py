"""Entries of what was stored as JSON, asked for by name and kind."""

_WORDS = {
    **{dict: "an object", list: "a list", str: "a text", bool: "true or false"},
    **{int: "a whole number", float: "a number", type(None): "null"},
}


def entry(stored, name, *kinds):
    """An entry of a stored object, refused if it is missing or of none of the kinds.

    Parameters
    ----------
    stored : dict
        Anything else has no entries.
    name : str
    *kinds : type
        As JSON has them: dict, list, str, bool, int, float, NoneType; a float may be whole.
    """
    if not isinstance(stored, dict):
        raise ValueError(f"it is no object with an entry {name!r}")
    if name not in stored:
        raise ValueError(f"its entry {name!r} is missing")
    value = stored[name]
    if type(value) in kinds or (float in kinds and type(value) is int):
        return value
    wanted = " or ".join(_WORDS[kind] for kind in kinds)
    raise ValueError(
        f"its entry {name!r} is {_WORDS.get(type(value), 'odd')}, but must be {wanted}"
    )


def check_entries(stored, names):
    """Refuse a stored object with an entry of another name: it is damaged, or means more."""
    if more := [name for name in stored if name not in names]:
        raise ValueError(f"it has {', '.join(repr(name)[:40] for name in more)}, which is unknown")
