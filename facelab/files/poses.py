"""Poses, edit logs and clips: as values and as small JSON files.

Every file carries a fingerprint of model and mesh. A file of another model, a damaged or a newer
one is refused with the reason, and nothing changes. Files are written whole or not at all.
"""

import json
import sys
from contextlib import contextmanager

from facelab.files.json_items import load_json
from facelab.posing.clips import Clip, check_clip
from facelab.posing.fingerprint import differs, fingerprint
from facelab.posing.log import check_log
from facelab.posing.session import PosingSession
from facelab.posing.state import PoseState, state_from_dict, state_to_dict
from facelab.posing.stored import check_entries, entry
from facelab.storage import atomic_path, check_writable, existing_file

_VERSION = 1
_HEAD = "format", "version", "mesh"
_CONTENT = {
    "pose": ("name", "state", "log"),
    "clip": ("model", "times", "poses", "easing", "names", "gaze"),
    "library": ("poses",),
}


def save_pose(path, session, name=""):
    """Write the pose of a session, its pins and the log of its edits.

    Parameters
    ----------
    path : str or Path
        Ending in .json.
    session : PosingSession
        A drag under way is not part of it.
    name : str, optional

    Raises
    ------
    RuntimeError
        Inside `with session.group()`: half a group is no log that can be replayed.
    """
    content = {"name": str(name), "state": state_to_dict(session.state), "log": session.log}
    _write(path, "pose", session, content)


def load_pose(path, session, models=()):
    """Bring a session to the pose of a file, as one step that can be undone.

    Parameters
    ----------
    path : str or Path
    session : PosingSession
        Of the same face.
    models : iterable of models or dict of str to model, optional
        To look for the pose's model in, beside the session's own.

    Returns
    -------
    state : PoseState

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing, damaged or newer file, or one of another face or model; nothing changes.
    """
    with _read(path, "pose", session) as stored:
        entry(stored, "name", str)
        session.restore(state_from_dict(entry(stored, "state", dict), session, models))
    return session.state


def read_log(path):
    """The log of edits that was saved with a pose, for `facelab.posing.replay`: list of dict.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing, damaged or newer file, and for entries that are no edits.
    """
    with _read(path, "pose") as stored:
        log = entry(stored, "log", list)
        check_log(log, PosingSession)
    return log


def save_library(path, poses, session):
    """Write named poses of a face, in their order, to one JSON file.

    Parameters
    ----------
    path : str or Path
        Ending in .json.
    poses : dict of str to PoseState
        Of any models of the session's face; what `read_library` gave as a dict is kept as it is.
    session : PosingSession
    """
    stored = {n: s if isinstance(s, dict) else state_to_dict(s) for n, s in poses.items()}
    stored = [{"name": str(name), "state": state} for name, state in stored.items()]
    _write(path, "library", session, {"poses": stored})


def load_library(path, session, models=()):
    """The named poses of a file.

    Parameters
    ----------
    path : str or Path
    session : PosingSession
        Of the same face.
    models : iterable of models or dict of str to model, optional
        To look for the models of the poses in, beside the session's own.

    Returns
    -------
    poses : dict of str to PoseState
        In their order.
    others : list of str
        Names of poses that were made with a model that is not at hand.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing, damaged or newer file, or one of another face.
    """
    found = read_library(path, session, models)
    poses = {name: state for name, state in found.items() if isinstance(state, PoseState)}
    return poses, [name for name in found if name not in poses]


def read_library(path, session, models=()):
    """All that a library file holds, in its order, to be written again with what is added.

    Arguments and errors as of `load_library`.

    Returns
    -------
    poses : dict of str to PoseState or dict
        A dict, as it is stored, where the model of the pose is not at hand.
    """
    found = {}
    given = models.values() if isinstance(models, dict) else models
    known = [fingerprint(model) for model in dict.fromkeys((*session.models, *given))]
    with _read(path, "library", session) as stored:
        for item in entry(stored, "poses", list):
            name = entry(item, "name", str)
            check_entries(item, ("name", "state"))
            if name in found:
                raise ValueError(f"pose {name!r} is there twice")
            found[name] = entry(item, "state", dict)
            made_by = entry(found[name], "model", dict)
            if not all(differs(made_by, own) for own in known):
                found[name] = state_from_dict(found[name], session, models)
                session.check_state(found[name])
    return found


def is_of_another_face(path, session):
    """Whether a file of poses is whole, but of another face than the session's."""
    try:
        face = load_json(existing_file(path, "file").read_bytes(), path, "file").value["mesh"]
        return bool(differs(face, fingerprint(session.neutral)))
    except (OSError, ValueError, TypeError, KeyError):
        return False


def _write(path, kind, session, content):
    check_writable(path)  # before the work
    head = {
        "format": f"facelab-{kind}",
        "version": _VERSION,
        "mesh": fingerprint(session.neutral),
    }
    text = json.dumps({**head, **content}, allow_nan=False)
    with atomic_path(path) as part:
        part.write_text(text, encoding="utf-8")


@contextmanager
def _read(path, kind, session=None):
    """The content of a file of this kind, for the face of the session; errors inside name it."""
    path = existing_file(path, f"{kind} file")
    stored = load_json(path.read_bytes(), path, f"{kind} file").value
    try:
        if stored.get("format") != f"facelab-{kind}":
            raise ValueError(f"it is not a {kind} file of facelab")
        version = entry(stored, "version", int)
        if version != _VERSION:
            remedy = "newer than known here: update facelab" if version > 1 else "save it again"
            raise ValueError(f"it is of version {str(version)[:9]}, {remedy}")
        _check_finite(stored)
        check_entries(stored, (*_HEAD, *_CONTENT[kind]))
        face = entry(stored, "mesh", dict)
        reason = differs(face, fingerprint(session.neutral) if session else face)
        if reason:
            raise ValueError(f"it is of another face: {reason}; load it with that face")
        yield stored
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {str(error).rstrip('.')}.") from error


def _check_finite(value):
    """Refuse numbers that no float holds, anywhere in what was read."""
    if isinstance(value, (list, dict)):
        for each in value.values() if isinstance(value, dict) else value:
            _check_finite(each)
    elif isinstance(value, (int, float)) and not abs(value) <= sys.float_info.max:
        raise ValueError("it is damaged: it holds a number beyond what a float can hold")


def save_clip(path, clip, session):
    """Write a clip made with a session's model to a JSON file.

    Raises
    ------
    ValueError, TypeError
        For a clip of another number of coefficients, or what is no clip; nothing is written.
    """
    check_clip(clip, session)
    content = {
        "model": fingerprint(session.model),
        "times": clip.times.tolist(),
        "poses": clip.poses.tolist(),
        "easing": clip.easing,
        "names": list(clip.names),
        **({"gaze": clip.gaze.tolist()} if clip.gaze.any() else {}),
    }
    _write(path, "clip", session, content)


def load_clip(path, session):
    """The clip of a file, refused as by `load_pose` unless it is of the session's model."""
    with _read(path, "clip", session) as stored:
        if reason := differs(entry(stored, "model", dict), fingerprint(session.model)):
            raise ValueError(f"it was made with another model: {reason}; use that model")
        times, poses, names = (entry(stored, x, list) for x in ("times", "poses", "names"))
        gaze = entry(stored, "gaze", list) if "gaze" in stored else None
        clip = Clip(times, poses, entry(stored, "easing", str), names, gaze)
        check_clip(clip, session)
    return clip
