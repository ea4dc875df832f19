"""A log of edits, done again."""

import contextlib
import inspect

from facelab.numeric.undo import edit_named
from facelab.posing.stored import check_entries
from facelab.posing.stored import entry as entry_of

_WALKS = {"undo": (), "redo": (), "seal": (), "group": ("key",), "end": ()}  # seal: of old logs


def replay(log, session, models=()):
    """Do the edits of a log again; on a fresh session they end in the same pose exactly.

    Parameters
    ----------
    log : list of dict
        As `PosingSession.log` and `read_log` have it.
    session : PosingSession
        As the one of the log was when it began.
    models : iterable of models or dict of str to model, optional
        Those that `use` and `restore` went to.

    Returns
    -------
    session : PosingSession

    Raises
    ------
    ValueError, TypeError
        For an entry that is no edit, or that fails, for a log that ends inside a group, and for
        what is no list; nothing changes.
    """
    check_log(log, type(session))
    with session.history.whole():
        _play(iter(enumerate(list(log))), session, models)
    return session


def check_log(log, kind):
    """Refuse what is no log of a kind of session: unknown edits, arguments, groups left open."""
    if not isinstance(log, (list, tuple)):
        raise TypeError(
            f"log is a {type(log).__name__}; give a list of entries (`read_log(path)`)."
        )
    inside = False
    for i, entry in enumerate(log):
        with _named(i, entry):
            do = _check_entry(entry, kind)
            if do in ("group", "end"):
                if inside == (do == "group"):
                    raise ValueError("a group is open already" if inside else "no group is open")
                inside = not inside
    if inside:
        raise ValueError("log ends inside a group: its 'end' is missing.")


def _check_entry(entry, kind):
    """What an entry does, refused if its arguments are not those of that."""
    do, needed = entry_of(entry, "do", str), ()
    known = _WALKS.get(do)
    if known is None:
        edit = edit_named(kind, do)
        if edit is None:
            raise ValueError("no such edit")
        takes = list(inspect.signature(edit).parameters.values())[1:]
        known, needed = ([p.name for p in takes], [p.name for p in takes if p.default is p.empty])
    if "t" in entry:
        entry_of(entry, "t", float)
    if do == "group" and "key" in entry:
        entry_of(entry, "key", str, type(None))
    for name in needed:
        if name not in entry:
            raise ValueError(f"its entry {name!r} is missing")
    check_entries(entry, ("t", "do", *known))
    return do


@contextlib.contextmanager
def _named(i, entry):
    """Errors inside name the entry of the log."""
    try:
        yield
    except Exception as error:
        do = repr(entry.get("do") if isinstance(entry, dict) else entry)[:60]
        raise ValueError(f"log[{i}] ({do}) cannot be done: {error}") from error


def _play(entries, session, models):
    """Do edits one after another; those inside a group up to its end."""
    for i, entry in entries:
        do = entry["do"]
        if do == "end":
            return
        arguments = {k: v for k, v in entry.items() if k not in ("t", "do")}
        with _named(i, entry):
            if do == "group":
                group = session.group(**arguments)
            elif do in _WALKS:
                {"undo": session.undo, "redo": session.redo, "seal": session.settle}[do]()
            else:
                edit = edit_named(type(session), do)
                for name in edit.reads.keys() & arguments.keys():
                    arguments[name] = edit.reads[name](arguments[name], session, models)
                edit(session, **arguments)
        if do == "group":
            with group:
                _play(entries, session, models)
