"""Poses, edit logs and clips: as values and as small JSON files.

Every file carries a fingerprint of model and mesh. A file of another model, a damaged or a newer
one is refused with the reason, and nothing changes. Files are written whole or not at all.
"""

import json

from facelab.posing.clips import Clip, check_clip
from facelab.posing.fingerprint import differs, fingerprint
from facelab.posing.state import state_from_dict, state_to_dict
from facelab.storage import atomic_path, existing_file

_VERSION = 1


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
    stored = _read(path, "pose", session)
    with _said_of(path):
        session.restore(state_from_dict(stored["state"], session, models))
    return session.state


def read_log(path):
    """The log of edits that was saved with a pose: list of dict."""
    stored = _read(path, "pose")
    with _said_of(path):
        return list(stored["log"])


def _write(path, kind, session, content):
    head = {
        "format": f"facelab-{kind}",
        "version": _VERSION,
        "mesh": fingerprint(session.neutral),
    }
    text = json.dumps({**head, **content}, allow_nan=False)
    with atomic_path(path) as part:
        part.write_text(text, encoding="utf-8")


def _read(path, kind, session=None):
    """The content of a file of this kind, for the face of the session."""
    path = existing_file(path, f"{kind} file")
    with _said_of(path):
        try:
            stored = json.loads(path.read_text(encoding="utf-8"))
        except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
            raise ValueError(f"it is damaged or no JSON ({error}); save it again.") from None
        if not isinstance(stored, dict) or stored.get("format") != f"facelab-{kind}":
            raise ValueError(f"it is not a {kind} file of facelab.")
        version = stored.get("version")
        if not isinstance(version, int) or version < 1:
            raise ValueError(f"its version is {version!r}; save it again.")
        if version > _VERSION:
            raise ValueError(
                f"it is of version {version}, newer than the {_VERSION} that is known here; update "
                "facelab."
            )
        if session is not None:
            reason = differs(stored["mesh"], fingerprint(session.neutral))
            if reason:
                raise ValueError(f"it is of another face: {reason}; load it with that face.")
        return stored


class _said_of:
    """Errors inside, also those of missing or misshapen entries, become one that names the file."""

    def __init__(self, path):
        self.path = path

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        if isinstance(error, (KeyError, TypeError, AttributeError, IndexError)):
            raise ValueError(
                f"{self.path}: it is damaged, an entry is missing or misshapen ({error}); save it "
                "again."
            ) from error
        if isinstance(error, ValueError):
            raise ValueError(f"{self.path}: {error}") from error


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
    }
    _write(path, "clip", session, content)


def load_clip(path, session):
    """The clip of a file, refused as by `load_pose` unless it is of the session's model."""
    stored = _read(path, "clip", session)
    with _said_of(path):
        if reason := differs(stored["model"], fingerprint(session.model)):
            raise ValueError(f"it was made with another model: {reason}; use that model.")
        clip = Clip(stored["times"], stored["poses"], stored["easing"], stored["names"])
        check_clip(clip, session)
        return clip
