"""What every reader of markers does alike: units, names, subjects, hidden markers, size, report."""

import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from facelab.checks import check_number, check_type
from facelab.files.words import distinct, listed
from facelab.geometry.size import face_scale
from facelab.motion import MarkerSequence
from facelab.storage import existing_file

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1000.0, "in": 25.4, "ft": 304.8}

_SPELLINGS = {
    "mm": ("millimeter", "millimetre"),
    "cm": ("centimeter", "centimetre"),
    "dm": ("decimeter", "decimetre"),
    "m": ("meter", "metre"),
    "in": ("inch", "inche"),
    "ft": ("foot", "feet"),
}
_ENOUGH = 6  # markers, to judge the size of a face by
_FARTHEST = 1e6  # mm; no capture volume is a kilometre wide
_FILLS = 3  # places of whole numbers at most that a marker has by filling
_REACH = 1000.0  # mm; no marker leaves its place so far for moments
_CHUNK = 2**21  # coordinates looked at together


@dataclass(frozen=True)
class MarkerReport:
    """What a reader of markers found, and what it left out. Print it.

    Attributes
    ----------
    path : Path
    frames, markers : int
    fps : float
    hidden : int
        Positions that are missing, of frames times markers.
    notes : tuple of str
        What was left out, renamed, assumed and counted.
    """

    path: Path
    frames: int
    markers: int
    fps: float
    hidden: int
    notes: tuple

    def __str__(self):
        share = 100 * self.hidden / max(1, self.frames * self.markers)
        first = (
            f"{self.path.name}: {self.frames} frames of {self.markers} markers at {self.fps:.6g} "
            f"frames/s, {share:.1f} % hidden"
        )
        return "\n".join([first, *self.notes])

    __repr__ = __str__


def unit_named(text):
    """The unit that a file means ("mm" for " Millimeters"), or None where it is no length."""
    word = text.strip().strip("[]()").rstrip(".").strip().lower()
    if word in MM_PER_UNIT:
        return word
    singular = word[:-1] if word.endswith("s") else word
    return next((unit for unit, words in _SPELLINGS.items() if singular in words), None)


def checked(path, what, unit, fps, subject):
    """The arguments that all readers of markers share, or a refusal: (path, fps)."""
    path = existing_file(path, what)
    if unit is not None and not isinstance(unit, str):
        raise TypeError(f"unit={unit!r} is not a string; name one of {', '.join(MM_PER_UNIT)}.")
    if unit is not None and unit not in MM_PER_UNIT:
        raise ValueError(f"unit={unit!r} is unknown; choose one of {', '.join(MM_PER_UNIT)}.")
    if subject is not None:
        check_type(subject, "subject", str, "give what stands before the colon of a name")
    return path, None if fps is None else check_number(fps, "fps", above=0)


def factor_of(path, said, unit, what):
    """Millimetres in the unit that the caller gave, or in the one that the file names."""
    unit = unit or unit_named(said)
    if unit is None:
        raise ValueError(
            f"{path}: {what} is {said[:40]!r}, readable are {', '.join(MM_PER_UNIT)}; say what it "
            'is with unit="mm".'
        )
    return MM_PER_UNIT[unit]


def warn(path, report, text, stacklevel=4):
    """Say something about a file at once, and keep it in its report."""
    report.append(text)
    warnings.warn(f"{path}: {text}.", stacklevel=stacklevel)


def resolve_names(path, labels, subject, report):
    """Names of the markers, and which of the file's points they are.

    A prefix that ends in a colon is the subject's name: it goes where there is one subject, stays
    where there are several, unless one is chosen. Doubled names are numbered, points without a
    name get one.

    Parameters
    ----------
    path : Path
        For messages.
    labels : list of str or None
        One for each point, "" for points without a name, None for those that are no markers.
    subject : str or None
    report : list of str
        Sentences are added.

    Returns
    -------
    names : list of str
    columns : ndarray of int
        Points that are kept, in the order of the file.
    """
    columns = [i for i, label in enumerate(labels) if label is not None]
    if not columns:
        raise ValueError(f"{path}: no markers in it.")
    split = [labels[i].strip().rpartition(":") for i in columns]
    loose = ["".join(s) for s in split if "".join(s).lower().startswith("unlabel")]
    split = [("", "", "".join(s)) if "".join(s) in loose else s for s in split]
    if loose:
        report.append(f"{len(loose)} marker(s) that Motive has not labelled ({listed(loose)})")
    subjects = Counter(before.strip() for before, colon, _ in split if colon)
    if subject is not None:
        if subject not in subjects:
            raise ValueError(
                f"{path}: subject={subject!r} is not in it; "
                + (f"it has {listed(subjects)}." if subjects else "its names have no prefix.")
            )
        chosen = [bool(colon) and before.strip() == subject for before, colon, _ in split]
        if not all(chosen):
            others = [s for s in subjects if s != subject]
            report.append(
                f"{chosen.count(False)} marker(s) of other subjects or of none left out "
                f"({listed(others) or 'no prefix'})"
            )
        columns = [c for c, keep in zip(columns, chosen, strict=True) if keep]
        split = [s for s, keep in zip(split, chosen, strict=True) if keep]
    if len(subjects) > 1 and subject is None:
        names = [before + colon + name for before, colon, name in split]
        report.append(
            f"{len(subjects)} subjects ({listed(subjects)}): names keep their prefix; choose one "
            "with subject="
        )
    else:
        names = [name.strip() for _, _, name in split]
        if subjects:
            report.append(f"prefix {subject or next(iter(subjects))}: taken off the names")
    nameless = [i for i, name in enumerate(names) if not name.strip(": ")]
    for i in nameless:
        names[i] = f"unlabelled_{columns[i] + 1}"
    if nameless:
        report.append(f"{len(nameless)} marker(s) without a name called {names[nameless[0]]}, ...")
    return _numbered(path, names, report), np.array(columns)


def _numbered(path, names, report):
    """The names, each once: `chin`, `chin_2`, `chin_3`."""
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        warn(path, report, f"name(s) that stand more than once were numbered: {listed(twice)}", 5)
    return distinct(names, "{}_{}")


def marker_sequence(path, positions, names, fps, report, judge=True):
    """The markers of a file as a sequence: hidden ones marked, nonsense refused, size judged.

    Parameters
    ----------
    path : Path
        For messages.
    positions : ndarray of shape (n_frames, n_markers, 3)
        Millimetres; NaN where hidden. Changed in place: exact zeros, positions seen in part and
        values that fill gaps (-9999, or -1 or 0, 0, -1 again and again) become NaN.
    names : list of str
    fps : float
    report : list of str
        Sentences are added.
    judge : bool, default=True
        Warn of a size that is no face's, and say it in the report.
    """
    zeros, part, beyond = 0, 0, Counter()
    odd = np.zeros(positions.shape[:2], dtype=bool)  # one value in x, y and z, or whole numbers
    rows = max(1, _CHUNK // max(1, 3 * len(names)))
    for first in range(0, len(positions), rows):
        some = positions[first : first + rows]
        far = np.abs(some) > _FARTHEST
        one = far[..., 0] & (some == some[..., :1]).all(axis=2) & np.isfinite(some[..., 0])
        beyond.update(some[one][:, 0].tolist())
        if one.any() and len(beyond) <= _FILLS:
            far[one], some[one] = False, np.nan
        if far.any():
            frame, marker, axis = (int(i) for i in np.argwhere(far)[0])
            raise ValueError(
                f"{path}: damaged, or in another unit: {names[marker]} in frame {first + frame} "
                f"(counted from 0) lies at {'xyz'[axis]} = {some[frame, marker, axis]:.4g} mm, "
                "more than a kilometre away."
            )
        missing = np.isnan(some)
        origin = (some == 0).all(axis=2)
        halves = missing.any(axis=2) & ~missing.all(axis=2)
        some[origin | halves] = np.nan
        alike = (some[..., :2] == some[..., 1:]).all(axis=2)
        odd[first : first + rows] = alike | (some == np.rint(some)).all(axis=2)
        zeros += int(origin.sum())
        part += int(halves.sum())
    if zeros:
        report.append(f"{zeros} position(s) at exactly 0, 0, 0 taken for hidden")
    filled = {(v,) * 3: count for v, count in beyond.items()} | _unfilled(positions, odd)
    one = {place: count for place, count in filled.items() if len({*place}) == 1}
    for of_kind, what in (
        (one, "one value in x, y and z"),
        ({p: n for p, n in filled.items() if p not in one}, "one place"),
    ):
        if of_kind:
            report.append(
                f"{sum(of_kind.values())} position(s) taken for hidden that fill a gap with {what} "
                f"({listed(map(_told, of_kind))})"
            )
    if part:
        report.append(f"{part} position(s) with one or two coordinates only taken for hidden")
    markers = MarkerSequence(positions, tuple(names), fps)
    if judge:
        _judge(path, markers, report)
    hidden = int((~markers.visible).sum())
    found = MarkerReport(path, len(positions), len(names), markers.fps, hidden, tuple(report))
    return replace(markers, report=found)


def _unfilled(positions, odd):
    """Places that stand for hidden markers, with their counts; they become NaN.

    Such a place is where its marker never is else: again and again, a jump away from all places
    that it visits; or once, beyond reach. Looked at are those that are `odd`, of shape (n_frames,
    n_markers).
    """
    places, some = set(), slice(None, None, max(1, len(positions) // 200))
    for marker in np.flatnonzero(odd.any(axis=0)):
        track, at = positions[:, marker], odd[:, marker]
        found, counts = np.unique(track[at], axis=0, return_counts=True)
        alike = (found[:, :2] == found[:, 1:]).all(axis=1)
        if (~alike).sum() > _FILLS:  # whole numbers are what this file counts in
            found, counts = found[alike], counts[alike]
            at = at & (track[:, :2] == track[:, 1:]).all(axis=1)
        rest = track[~at & np.isfinite(track[:, 0])].astype(float)
        steps = np.linalg.norm(np.diff(rest, axis=0), axis=1)
        jump = 10 * np.median(steps[steps > 0]) if steps.any() else np.inf
        if len(rest) < 2:  # far from the others, then?
            rest = positions[some][~odd[some] & np.isfinite(positions[some][..., 0])]
        if not len(rest):
            continue
        low, high = rest.min(axis=0), rest.max(axis=0)
        reach = max(_REACH, 10 * np.linalg.norm(high - low))
        for place, count in zip(found, counts, strict=True):
            outside = np.linalg.norm(np.maximum(0, np.maximum(low - place, place - high)))
            again = count > 2 and np.linalg.norm(rest - place, axis=1).min() > jump
            if outside > reach or again:
                places.add(tuple(place.tolist()))
    filled = {}
    for place in sorted(places):
        at = odd & (positions == np.array(place, positions.dtype)).all(axis=2)
        positions[at] = np.nan
        filled[place] = int(at.sum())
    return filled


def _told(place):
    """A place that fills gaps, in short: -9999 for one value in all three."""
    return " ".join(f"{value:.6g}" for value in (place[:1] if len({*place}) == 1 else place))


def _judge(path, markers, report):
    picked = np.unique(np.linspace(0, markers.n_frames - 1, 200).astype(int))
    some = markers.positions[picked].astype(float)
    some = some[np.isfinite(some[..., 0]).sum(axis=1) >= _ENOUGH]
    if not len(some):
        return
    box = np.median(np.nanmax(some, axis=1) - np.nanmin(some, axis=1), axis=0)
    scale = face_scale(float(box.max()))
    if scale == 1:
        return
    said = f"the markers fill {box[0]:.4g} x {box[1]:.4g} x {box[2]:.4g} mm, which is no face"
    if scale is not None:
        meant = next((u for u, mm in MM_PER_UNIT.items() if mm == scale), "tenths of a millimetre")
        said += f"; times {scale:g} it would be one, as if the unit were {meant}: see unit="
    warn(path, report, said, 6)
