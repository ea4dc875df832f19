"""A log of edits, done again."""

import contextlib
import inspect

from facelab.numeric.undo import edit_named


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
    if not isinstance(log, (list, tuple)):
        raise TypeError(
            f"log is a {type(log).__name__}; give a list of entries (`read_log(path)`)."
        )
    with session.history.whole():
        _play(iter(enumerate(list(log))), session, models)
    return session


def _play(entries, session, models, inside=False):
    """Do edits one after another; those inside a group up to its end."""
    for i, entry in entries:
        with _named(i, entry):
            do, arguments = _parts(entry)
            if do == "group":
                if inside:
                    raise ValueError("a group is open already")
                group = session.group(**_checked(arguments, (), ("key",)))
            elif do == "end":
                if not inside:
                    raise ValueError("no group is open")
                return
            else:
                _redo(do, arguments, session, models)
                continue
        with group:
            _play(entries, session, models, inside=True)
    if inside:
        raise ValueError("log ends inside a group: its 'end' is missing.")


@contextlib.contextmanager
def _named(i, entry):
    """Errors inside name the entry of the log."""
    try:
        yield
    except Exception as error:
        do = repr(entry.get("do") if isinstance(entry, dict) else entry)[:60]
        raise ValueError(f"log[{i}] ({do}) cannot be done: {error}") from error


def _parts(entry):
    """What an entry does, and its arguments as they are written."""
    if not isinstance(entry, dict):
        raise TypeError("it is no dict with an entry 'do'")
    if not isinstance(entry.get("do"), str):
        raise ValueError("its entry 'do' is missing or no text")
    return entry["do"], {k: v for k, v in entry.items() if k not in ("t", "do")}


def _redo(do, arguments, session, models):
    if do in ("undo", "redo", "seal"):  # seal: old logs have it
        _checked(arguments, (), ())
        {"undo": session.undo, "redo": session.redo, "seal": session.settle}[do]()
        return
    edit = edit_named(session, do)
    if edit is None:
        raise ValueError("no such edit")
    known = list(inspect.signature(edit).parameters.values())[1:]
    _checked(arguments, [p.name for p in known if p.default is p.empty], [p.name for p in known])
    read = {k: edit.reads[k] for k in arguments if k in edit.reads}
    edit(session, **arguments | {k: r(arguments[k], session, models) for k, r in read.items()})


def _checked(arguments, needed, known):
    """The arguments, refused if one is missing or too many."""
    for name in needed:
        if name not in arguments:
            raise ValueError(f"its entry {name!r} is missing")
    if more := [name for name in arguments if name not in known]:
        raise ValueError(f"it takes no {', '.join(map(repr, more))}")
    return arguments
