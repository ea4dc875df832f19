"""Poses, edit logs and clips: as values and as small JSON files.

Every file carries a fingerprint of model and mesh. A file of another model, a damaged or a newer
one is refused with the reason, and nothing changes. Files are written whole or not at all.
"""

import contextlib
import hashlib
import json
from dataclasses import dataclass, replace

import numpy as np

from facelab.blendshapes import BlendshapeRig
from facelab.errors import as_finite, check_choice, check_index, check_number
from facelab.io import atomic_path, existing_file
from facelab.mesh import TriangleMesh
from facelab.pose_solver import sizes_of
from facelab.pose_state import frozen_copy

_VERSION = 1
_PROBES = 4  # random projections in a fingerprint
_CLOSE = 1e-6  # of their size: the same training on another machine differs by rounding


# --- fingerprints ---------------------------------------------------------------------------------


def fingerprint(thing):
    """What tells a model or mesh from others, as a small dict for JSON.

    Sizes, and a few random projections of all its numbers, to be compared with a tolerance: a
    model trained again on the same data is the same, though its last bits differ.

    Parameters
    ----------
    thing : RegionModel, HolisticModel, BlendshapeRig or TriangleMesh
    """
    if isinstance(thing, TriangleMesh):
        faces = hashlib.sha256(np.ascontiguousarray(thing.faces, dtype="<i8")).hexdigest()[:16]
        return _print("mesh", [thing.n_vertices, len(thing.faces), faces], [thing.vertices])
    if isinstance(thing, BlendshapeRig):
        return _print("rig", list(thing.names), [thing.deltas])
    sizes = [len(thing.mean_) // 3, *(int(n) for n in thing.n_components_)]
    return _print("model", sizes, [thing.mean_, *thing.components_])


def _print(kind, sizes, arrays):
    rng = np.random.default_rng(0)
    probes = np.zeros(_PROBES)
    scale = 0.0
    for array in arrays:
        x = np.ravel(array).astype(float)
        probes += rng.standard_normal((_PROBES, x.size)) @ x
        scale += x @ x
    return {"kind": kind, "sizes": sizes, "scale": float(np.sqrt(scale)), "probes": probes.tolist()}


def _differs(stored, own):
    """What differs between two fingerprints, in words; empty if nothing does."""
    if stored["kind"] != own["kind"]:
        return f"it is of a {stored['kind']}, not of a {own['kind']}"
    if stored["sizes"] != own["sizes"]:
        return f"its sizes or names are {_short(stored['sizes'])}, not {_short(own['sizes'])}"
    off = np.abs(np.subtract(stored["probes"], own["probes"])).max()
    return "its numbers are others" if off > _CLOSE * own["scale"] else ""


def _short(sizes):
    shown = ", ".join(map(str, sizes[:6]))
    return shown + (", ..." if len(sizes) > 6 else "")


# --- states ---------------------------------------------------------------------------------------


def state_to_dict(state):
    """A `PoseState` for JSON; numbers keep every bit."""
    return {
        "model": fingerprint(state.model),
        "beta": state.beta,
        "gamma": state.gamma,
        "limit": state.limit,
        "pins": [
            {
                "vertex": int(v),
                "displacement": np.asarray(t).tolist(),
                "weight": state.weights.get(v, 1.0),
                "locked": v in state.locked,
            }
            for v, t in state.pins.items()
        ],
        "c_0": state.c_0.tolist(),
        "molded": state.molded.tolist(),
        "coefficients": state.coefficients.tolist(),
    }


def _state_from_dict(stored, session, models=()):
    """The `PoseState` of a dict, checked against the session."""
    model = _find_model(stored["model"], session, models)
    n = session.neutral.n_vertices
    pins, weights, locked = {}, {}, set()
    for pin in stored["pins"]:
        v = check_index(pin["vertex"], "vertex", n, "vertices of the face")
        pins[v] = as_finite(pin["displacement"], f"displacement of pin {v}", (3,))
        weight = check_number(pin["weight"], f"weight of pin {v}", above=0)
        weights |= {} if weight == 1 else {v: weight}
        locked |= {v} if pin["locked"] else set()
    P = sizes_of(model)[1]
    arrays = {x: as_finite(stored[x], x, (P,)) for x in ("c_0", "molded", "coefficients")}
    limit = stored["limit"]
    return replace(
        session.state,
        model=model,
        beta=check_number(stored["beta"], "beta", low=0),
        gamma=check_number(stored["gamma"], "gamma", above=0),
        limit=limit if limit is None else check_number(limit, "limit", above=0),
        pins=pins,
        weights=weights,
        locked=frozenset(locked),
        **arrays,
    )


def _find_model(stored, session, models):
    """The model of a fingerprint: the session's own, one that it had before, or one given."""
    given = models.values() if isinstance(models, dict) else models
    reasons = []
    for model in (*session.models, *given):
        reasons.append(_differs(stored, fingerprint(model)))
        if not reasons[-1]:
            return model
    raise ValueError(f"it was made with another model: {reasons[0]}; use that model.")


# --- files ----------------------------------------------------------------------------------------


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
    session._refuse_in_group()
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
        session.restore(_state_from_dict(stored["state"], session, models))
    return session.state


def read_log(path):
    """The log of edits that was saved with a pose: list of dict."""
    stored = _read(path, "pose")
    with _said_of(path):
        return list(stored["log"])


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
        session.use(_find_model(arguments["model"], session, models))
    elif do == "restore":
        session.restore(_state_from_dict(arguments["state"], session, models))
    elif do in _EDITS:
        getattr(session, do)(**arguments)
    else:
        raise ValueError("no such edit")


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
            reason = _differs(stored["mesh"], fingerprint(session.neutral))
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


# --- clips ----------------------------------------------------------------------------------------


def interpolate(a, b, share):
    """Coefficients between two poses: a at share 0, b at 1, shape (P,).

    Parameters
    ----------
    a, b : PoseState
        Of the same model.
    share : float
        0 to 1.
    """
    share = check_number(share, "share", low=0, high=1)
    if a.model is not b.model:
        raise ValueError("a and b are poses of two models; restore one and `use` the other's.")
    return (1 - share) * a.coefficients + share * b.coefficients


@dataclass(frozen=True, eq=False)
class Clip:
    """Poses at times, and what is between them. Its arrays are copies that cannot be written to.

    Parameters
    ----------
    times : array_like of shape (K,)
        Seconds, 0 or more, ascending.
    poses : array_like of shape (K, P)
        Coefficients, counted from the neutral.
    easing : {"smooth", "linear"}
        Between two poses the share of the second rises as 3 s^2 - 2 s^3 (at rest in every key) or
        as s. It never leaves the way from one to the other: weights of a rig stay within [0, 1].
    names : sequence of str, optional
        Of the key poses.

    Raises
    ------
    ValueError
        For times that do not ascend, poses that are not finite, or names of another number.
    """

    times: np.ndarray
    poses: np.ndarray
    easing: str = "smooth"
    names: tuple = None

    def __post_init__(self):
        times = as_finite(self.times, "times", ("n_keys",))
        poses = as_finite(self.poses, "poses", (len(times), "P"))
        if not len(times):
            raise ValueError("times is empty: a clip needs at least one key.")
        if times[0] < 0 or (np.diff(times) <= 0).any():
            raise ValueError(f"times={times.tolist()} must ascend from 0 or more, each once.")
        names = self.names
        names = [f"key {k + 1}" for k in range(len(times))] if names is None else names
        names = tuple(map(str, names))
        if len(names) != len(times):
            raise ValueError(f"names has {len(names)} entries for {len(times)} keys.")
        check_choice(self.easing, "easing", ("smooth", "linear"))
        values = {"times": frozen_copy(times), "poses": frozen_copy(poses), "names": names}
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, keys, easing="smooth"):
        """A clip of (seconds, `PoseState`) pairs in any order; all of one model."""
        keys = sorted(keys, key=lambda key: key[0])
        if len({id(state.model) for _, state in keys}) > 1:
            raise ValueError("keys are poses of several models; a clip needs one.")
        return cls([t for t, _ in keys], [state.coefficients for _, state in keys], easing)

    @property
    def duration(self):
        """Seconds up to the last key."""
        return float(self.times[-1])

    def with_key(self, seconds, coefficients, name=None):
        """The clip with one more pose, or another one at a time that has one already."""
        if hasattr(coefficients, "coefficients"):  # a PoseState
            coefficients = coefficients.coefficients
        coefficients = as_finite(coefficients, "coefficients", self.poses.shape[1:])
        seconds = check_number(seconds, "seconds", low=0)
        keep = self.times != seconds
        times = np.append(self.times[keep], seconds)
        poses = np.vstack([self.poses[keep], coefficients])
        names = [n for n, k in zip(self.names, keep, strict=True) if k]
        names.append(f"key {len(names) + 1}" if name is None else name)
        order = np.argsort(times)
        return Clip(times[order], poses[order], self.easing, [names[i] for i in order])

    def without_key(self, index):
        """The clip without one of its keys."""
        index = check_index(index, "index", len(self.times), "keys")
        keep = np.arange(len(self.times)) != index
        names = [n for n, k in zip(self.names, keep, strict=True) if k]
        return Clip(self.times[keep], self.poses[keep], self.easing, names)

    def moved_key(self, index, seconds):
        """The clip with one of its keys at another time."""
        index = check_index(index, "index", len(self.times), "keys")
        times = self.times.copy()
        times[index] = check_number(seconds, "seconds", low=0)
        order = np.argsort(times, kind="stable")
        names = [self.names[i] for i in order]
        return Clip(times[order], self.poses[order], self.easing, names)

    def shares(self, seconds):
        """How much of each key pose there is at some times: (n, K), rows sum to one."""
        seconds = np.atleast_1d(np.asarray(seconds, dtype=float))
        shares = np.zeros((len(seconds), len(self.times)))
        rows = np.arange(len(seconds))
        k = np.searchsorted(self.times, seconds, side="right").clip(1, len(self.times)) - 1
        after = np.minimum(k + 1, len(self.times) - 1)
        gap = np.where(after > k, self.times[after] - self.times[k], 1)
        s = ((seconds - self.times[k]) / gap).clip(0, 1) * (after > k)
        if self.easing == "smooth":
            s = s * s * (3 - 2 * s)
        shares[rows, k] = 1 - s
        shares[rows, after] += s
        return shares

    def at(self, seconds):
        """Coefficients at a time, shape (P,); before the first key and after the last, theirs."""
        return self.shares(check_number(seconds, "seconds"))[0] @ self.poses

    def sample(self, fps=30.0):
        """The clip at a steady beat.

        Returns
        -------
        times : ndarray of shape (n_frames,)
            Seconds, from 0 to the last beat within the clip.
        coefficients : ndarray of shape (n_frames, P)
        """
        fps = check_number(fps, "fps", above=0)
        times = np.arange(int(np.floor(self.duration * fps + 1e-9)) + 1) / fps
        return times, self.shares(times) @ self.poses


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
        if reason := _differs(stored["model"], fingerprint(session.model)):
            raise ValueError(f"it was made with another model: {reason}; use that model.")
        clip = Clip(stored["times"], stored["poses"], stored["easing"], stored["names"])
        check_clip(clip, session)
        return clip


def check_clip(clip, session):
    """Refuse what is no `Clip`, or one whose poses the session's model cannot have."""
    if not isinstance(clip, Clip):
        raise TypeError(f"clip is a {type(clip).__name__}; give a Clip.")
    P, found = sizes_of(session.model)[1], clip.poses.shape[1]
    if found != P:
        raise ValueError(
            f"clip has {found} coefficients in each pose, but the session's model has {P}; use the "
            "model that made the clip."
        )
