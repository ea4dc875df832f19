"""Poses in time: clips, and what is between two poses."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from facelab.checks import as_finite, check_choice, check_index, check_number, check_type
from facelab.posing.ranges import check_gaze, check_size
from facelab.posing.state import PoseState, frozen_copy

_LONGEST = 1e6  # seconds that a clip may last
_MOST = 2.5e8  # numbers that samples of it may take in memory


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
    for name, pose in (("a", a), ("b", b)):
        check_type(pose, name, PoseState, "give one, such as session.state")
    if a.model is not b.model:
        raise ValueError("a and b are poses of two models; restore one and `use` the other's.")
    return (1 - share) * a.coefficients + share * b.coefficients


def interpolate_gaze(a, b, share):
    """Where the eyes look between two poses, shape (2,), as `interpolate`."""
    share = check_number(share, "share", low=0, high=1)
    return (1 - share) * np.array(a.gaze) + share * np.array(b.gaze)


@dataclass(frozen=True, eq=False)
class Clip:
    """Poses at times, and what is between them. Its arrays are copies that cannot be written to.

    Parameters
    ----------
    times : array_like of shape (K,)
        Seconds, 0 to a million, ascending.
    poses : array_like of shape (K, P)
        Coefficients, counted from the neutral.
    easing : {"smooth", "linear"}
        Between two poses the share of the second rises as 3 s^2 - 2 s^3 (at rest in every key) or
        as s. It never leaves the way from one to the other: weights of a rig stay within [0, 1].
    names : sequence of str, optional
        Of the key poses.
    gaze : array_like of shape (K, 2), optional
        Of the key poses, as `PoseState` has it; all look ahead if left out.

    Raises
    ------
    ValueError
        For times that do not ascend, poses that are not finite or beyond any face, or names of
        another number.
    """

    times: np.ndarray
    poses: np.ndarray
    easing: str = "smooth"
    names: tuple = None
    gaze: np.ndarray = None

    def __post_init__(self):
        times = as_finite(self.times, "times", ("n_keys",))
        poses = as_finite(self.poses, "poses", (len(times), "P"))
        if not len(times):
            raise ValueError("times is empty: a clip needs at least one key.")
        if times[0] < 0 or times[-1] > _LONGEST or (np.diff(times) <= 0).any():
            shown = ", ".join(f"{t:g}" for t in times[:6]) + ", ..." * (len(times) > 6)
            raise ValueError(
                f"times={shown} must ascend from 0 or more to at most {_LONGEST:g}, each once."
            )
        check_size(poses)
        names = self.names
        names = [f"key {k + 1}" for k in range(len(times))] if names is None else names
        names = tuple(check_type(n, "a name of a key", str, "give texts") for n in names)
        if len(names) != len(times):
            raise ValueError(f"names has {len(names)} entries for {len(times)} keys.")
        check_choice(self.easing, "easing", ("smooth", "linear"))
        gaze = np.zeros((len(times), 2)) if self.gaze is None else self.gaze
        gaze = as_finite(gaze, "gaze", (len(times), 2))
        for k, each in enumerate(gaze):
            check_gaze(each, f"gaze of key {k + 1}")
        values = {"times": frozen_copy(times), "poses": frozen_copy(poses), "names": names}
        values["gaze"] = frozen_copy(gaze)
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, keys, easing="smooth"):
        """A clip of (seconds, `PoseState`) pairs in any order; all of one model."""
        keys = list(keys) if isinstance(keys, Iterable) else [keys]
        for i, key in enumerate(keys):
            pair = isinstance(key, (tuple, list)) and len(key) == 2
            if not pair or not isinstance(key[1], PoseState):
                raise TypeError(
                    f"keys[{i}] is no pair of seconds and a PoseState; give (0.5, session.state)."
                )
            check_number(key[0], f"seconds of keys[{i}]", low=0)
        keys = sorted(keys, key=lambda key: key[0])
        if len({id(state.model) for _, state in keys}) > 1:
            raise ValueError("keys are poses of several models; a clip needs one.")
        poses, gaze = ([getattr(s, n) for _, s in keys] for n in ("coefficients", "gaze"))
        return cls([t for t, _ in keys], poses, easing, gaze=gaze)

    @property
    def duration(self):
        """Seconds up to the last key."""
        return float(self.times[-1])

    def with_key(self, seconds, coefficients, name=None):
        """The clip with one more pose, or another one at a time that has one already."""
        looks = getattr(coefficients, "gaze", (0.0, 0.0))
        if hasattr(coefficients, "coefficients"):  # a PoseState
            coefficients = coefficients.coefficients
        coefficients = as_finite(coefficients, "coefficients", self.poses.shape[1:])
        seconds = check_number(seconds, "seconds", low=0)
        keep = self.times != seconds
        times = np.append(self.times[keep], seconds)
        poses = np.vstack([self.poses[keep], coefficients])
        gaze = np.vstack([self.gaze[keep], looks])
        names = [n for n, k in zip(self.names, keep, strict=True) if k]
        names.append(f"key {len(names) + 1}" if name is None else name)
        order = np.argsort(times)
        names = [names[i] for i in order]
        return Clip(times[order], poses[order], self.easing, names, gaze[order])

    def without_key(self, index):
        """The clip without one of its keys."""
        index = check_index(index, "index", len(self.times), "keys")
        keep = np.arange(len(self.times)) != index
        names = [n for n, k in zip(self.names, keep, strict=True) if k]
        return Clip(self.times[keep], self.poses[keep], self.easing, names, self.gaze[keep])

    def moved_key(self, index, seconds):
        """The clip with one of its keys at another time."""
        index = check_index(index, "index", len(self.times), "keys")
        times = self.times.copy()
        times[index] = check_number(seconds, "seconds", low=0)
        order = np.argsort(times, kind="stable")
        names = [self.names[i] for i in order]
        return Clip(times[order], self.poses[order], self.easing, names, self.gaze[order])

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

    def gaze_at(self, seconds):
        """Where the eyes look at a time, shape (2,), as `PoseState` has it."""
        return self.shares(check_number(seconds, "seconds"))[0] @ self.gaze

    def with_easing(self, easing):
        """The clip with another way from key to key."""
        return replace(self, easing=easing)

    def sample(self, fps=30.0):
        """The clip at a steady beat.

        Returns
        -------
        times : ndarray of shape (n_frames,)
            Seconds, from 0 to the last beat within the clip.
        coefficients : ndarray of shape (n_frames, P)
        """
        fps = check_number(fps, "fps", above=0, high=1000)
        n = int(np.floor(self.duration * fps + 1e-9)) + 1
        if n * sum(self.poses.shape) > _MOST:
            raise ValueError(
                f"fps={fps:g} makes {n:,} poses of {self.duration:g} s, more than memory should "
                "hold; sample a part of them with `at`."
            )
        times = np.arange(n) / fps
        return times, self.shares(times) @ self.poses


def check_clip(clip, session):
    """Refuse what is no `Clip`, or one whose poses the session's model cannot have."""
    check_type(clip, "clip", Clip, "make one of the session's poses")
    P, found = session.model.n_coefficients, clip.poses.shape[1]
    if found != P:
        raise ValueError(
            f"clip has {found} coefficients in each pose, but the session's model has {P}; use the "
            "model that made the clip."
        )
    if session.model.bounds is not None:
        low, high = session.model.bounds
        if clip.poses.min() < low or clip.poses.max() > high:
            raise ValueError(
                f"clip has coefficients from {clip.poses.min():g} to {clip.poses.max():g}, but "
                f"those of the session's model lie between {low:g} and {high:g}."
            )
