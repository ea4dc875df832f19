"""A log of edits, done again."""

import contextlib

from facelab.posing.state import find_model, state_from_dict


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
    with session._all_or_nothing():
        _play(iter(enumerate(list(log))), session, models)
    return session


def _play(entries, session, models, inside=False):
    """Do edits one after another; those inside a group up to its end."""
    for i, entry in entries:
        with _named(i, entry):
            do = entry["do"]
            arguments = {k: v for k, v in entry.items() if k not in ("t", "do")}
            if do == "end":
                if not inside:
                    raise ValueError("no group is open")
                return
            if do != "group":
                _redo(do, arguments, session, models)
                continue
            if inside:
                raise ValueError("a group is open already")
            group = session.group(**arguments)
        with group:
            _play(entries, session, models, inside=True)
    if inside:
        raise ValueError("log ends inside a group: its 'end' is missing.")


@contextlib.contextmanager
def _named(i, entry):
    """Errors inside, also those of missing or misshapen arguments, name the entry of the log."""
    try:
        if not isinstance(entry, dict):
            raise TypeError("it is no dict with an entry 'do'")
        yield
    except Exception as error:
        do = repr(entry.get("do") if isinstance(entry, dict) else entry)[:60]
        why = f"its entry {error} is missing" if isinstance(error, KeyError) else error
        raise ValueError(f"log[{i}] ({do}) cannot be done: {why}") from error


_EDITS = frozenset(
    "set_pin remove_pin mirror_pin keep reset reset_region set apply mirror mold undo redo "
    "seal".split()
)


def _redo(do, arguments, session, models):
    if do == "pull":
        session.drag(**arguments)
        session.release()
    elif do == "symmetric":
        session.symmetric = arguments["on"]
    elif do == "use":
        session.use(find_model(arguments["model"], session, models))
    elif do == "restore":
        session.restore(state_from_dict(arguments["state"], session, models))
    elif do in _EDITS:
        getattr(session, do)(**arguments)
    else:
        raise ValueError("no such edit")
