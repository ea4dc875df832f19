"""Time codes: which frame each row of a recording is, at which rate, and where time is missing.

A time code counts frames (`HH:MM:SS:FF.fff`), as SMPTE ST 12-1 has it. A `;` marks drop-frame
counting: at 29.97 or 59.94 frames a second the numbers 0 and 1 (or 0 to 3) are passed over at the
start of every minute but each tenth, so that the code keeps up with the clock; no frame is missing
there. Clock times (`HH:MM:SS.mmm`) and plain seconds are read too.
"""

import math
import re
from dataclasses import dataclass, field

import numpy as np

LONGEST_FILL = 2.0
"""Seconds that may be filled with lost frames; where more is missing, a gap is marked in time."""

SLOWEST, FASTEST = 5, 240
"""Frames a second that a face is recorded with."""

CODED = (24, 25, 30, 50, 60, 120)
"""Frames in a second that a time code is commonly made for."""

_BASES = (5, 10, 12, 15, 20, 24, 25, 30, 48, 50, 60, 90, 100, 120, 240)  # frames in a second
_RATES = (*_BASES, *(1000 * n / 1001 for n in (24, 30, 48, 60, 120, 240)))
_NEVER_DROPPED = (24, 25, 48, 50)  # common rates without drop-frame counting
_DAY = 86400
_SMPTE = re.compile(
    r"(\d{1,2})[:;]([0-5]?\d)[:;]([0-5]?\d)([:;])(\d{1,3})(?:[.,](\d{1,9}))?", re.ASCII
)
_CLOCK = re.compile(  # perhaps with a date in front, and the zone behind, as ISO 8601 has it
    r"(?:\d{4}-\d\d-\d\d[T ])?(?:(\d{1,2}):)?([0-5]?\d):([0-5]?\d)(?:[.,](\d{1,9}))?"
    r"(?:Z|[+-]\d\d:?\d\d)?",
    re.ASCII,
)
_SECONDS = re.compile(
    r"[+-]?(?:\d{1,15}(?:[.,]\d{0,20})?|[.,]\d{1,20})(?:[eE]-?\d{1,2})?", re.ASCII
)
_REMEDY = "if the rows follow one another at a fixed rate, say so: fps=30"


@dataclass(frozen=True)
class Timing:
    """Where the rows of a recording stand in time.

    Parameters
    ----------
    slots : ndarray of int, shape (n_rows,)
        The frame that each row is, from 0, rising.
    fps : float
        Frames a second.
    gaps : dict of int to float
        Seconds missing before a frame, where they are too many to be filled.
    notes : tuple of str
        What had to be decided, in words.
    """

    slots: np.ndarray
    fps: float
    gaps: dict = field(default_factory=dict)
    notes: tuple = ()


@dataclass(frozen=True)
class _Beats:
    """What the codes count: the beat of each row, and beats in a second of theirs."""

    at: np.ndarray
    per_second: float
    drop: bool = False  # a second of theirs lasts 1.001 of the clock's
    notes: tuple = ()

    def of_the_clock(self, rate):
        return float(rate * 1000 / 1001 if self.drop else rate)


def timing(found):
    """Where the rows of a recording stand in time, by their time codes.

    The rate is the one at which the codes run, taken as a common one (24, 25, 29.97, 30, 50, 59.94,
    60, ...) where they allow that. Frames missing between two rows at most `LONGEST_FILL` seconds
    apart are lost ones; a longer silence is a gap.

    Parameters
    ----------
    found : Recording
        With codes that are all of one kind.

    Returns
    -------
    Timing

    Raises
    ------
    ValueError
        For codes that cannot be read, do not run forwards, or run at no rate a face is recorded
        with; the message names file and line, and `fps=` where that helps.
    """
    beats = _beats(found)
    step = np.diff(beats.at)
    if (step <= 0).any():
        i = int(np.flatnonzero(step <= 0)[0])
        how = "repeats" if step[i] == 0 else "runs back behind"
        raise ValueError(
            f"{found.place(i + 1)}: time code {found.codes[i + 1]} {how} that of "
            f"{found.what} {found.rows[i]}, {found.codes[i]}; remove it, or, {_REMEDY}."
        )
    if not len(step):
        fps = beats.of_the_clock(beats.per_second)
        return Timing(np.zeros(1, dtype=int), fps, notes=beats.notes)
    rough = beats.per_second / np.median(step)
    if not 0.99 * SLOWEST <= rough <= 1.01 * FASTEST:
        raise ValueError(
            f"{found.path}, {found.what}s {found.rows[0]} to {found.rows[-1]}: the time codes "
            f"amount to {rough:.3g} frames/s, and a face is recorded with {SLOWEST} to {FASTEST}; "
            f"{_REMEDY}."
        )
    slots, rate, squeezed = _placed(beats.at / beats.per_second, rough)
    fps, gaps = beats.of_the_clock(rate), {}
    for i in np.flatnonzero(np.diff(slots) > LONGEST_FILL * rate).tolist():
        missing = int(slots[i + 1] - slots[i] - 1)
        slots[i + 1 :] -= missing
        gaps[int(slots[i + 1])] = missing / fps
    _refuse_made_up(slots, squeezed, len(gaps), found)
    return Timing(slots, fps, gaps, beats.notes)


def _refuse_made_up(slots, squeezed, n_gaps, found):
    """Where so much would be missing or does not fit, the codes do not count frames."""
    step = np.diff(slots)
    filled = int((step - 1).sum())
    broken = int((step > 1).sum()) + n_gaps
    if filled > max(len(slots), 60) or broken > max(3, len(step) / 2) or squeezed > len(step) / 8:
        raise ValueError(
            f"{found.place(0)} and below: by their time codes these {len(slots)} rows lack "
            f"{filled} frames and more in {n_gaps} gaps, and {squeezed} come too soon: such codes "
            f"do not count frames; {_REMEDY}."
        )


# --- what the codes say ---------------------------------------------------------------------------


def _beats(found):
    first = found.codes[0]
    kinds = ((_SMPTE, _smpte), (_CLOCK, _clock), (_SECONDS, _seconds))
    kind, read = next((k for k in kinds if k[0].fullmatch(first)), kinds[-1])
    matches = [kind.fullmatch(text) for text in found.codes]
    if None in matches:
        i = matches.index(None)
        wanted = f"of the kind of the first, {first}" if i else "HH:MM:SS:FF.fff"
        raise ValueError(
            f"{found.place(i)}: time code {found.codes[i][:40]!r} is not {wanted}"
            + ("." if i else f", a clock time or seconds; {_REMEDY}.")
        )
    return read([m.groups(default="0") for m in matches], found)


def _past_midnight(at, day):
    """Times that pass midnight run on instead of back."""
    return at + day * np.cumsum(np.diff(at, prepend=at[0]) < -day * 23 / 24)


def _minutes(hours, minutes, found):
    hours = np.array([int(h) for h in hours])
    if (hours > 23).any():
        i = int(np.flatnonzero(hours > 23)[0])
        raise ValueError(
            f"{found.place(i)}: time code {found.codes[i]} has {hours[i]} hours, and a day has 24."
        )
    return hours * 60 + np.array([int(m) for m in minutes])


def _fractions(digits):
    return np.array([int(d) / 10 ** len(d) for d in digits])


def _seconds(parts, found):
    seconds = np.array([float(text.replace(",", ".")) for text in found.codes])
    if len(seconds) > 1 and not (seconds % 1).any():
        raise ValueError(
            f"{found.place(0)}: {found.codes[0]}, {found.codes[1]}, ... count rows "
            "or whole seconds, and no rate is told; name the column timestamp_ms if it counts "
            f"milliseconds; {_REMEDY}."
        )
    return _Beats(seconds, 1)


def _clock(parts, found):
    hours, minutes, seconds, digits = zip(*parts, strict=True)
    if {len(d) for d in digits} == {2} and max(digits) < "60":
        raise ValueError(
            f"{found.place(0)}: {found.codes[0]} may count frames or hundredths of a "
            f"second; {_REMEDY}."
        )
    whole = 60 * _minutes(hours, minutes, found) + np.array([int(s) for s in seconds])
    return _Beats(_past_midnight(whole + _fractions(digits), _DAY), 1)


def _smpte(parts, found):
    hours, minutes, seconds, marks, frames, digits = zip(*parts, strict=True)
    minute = _minutes(hours, minutes, found)
    seconds = np.array([int(s) for s in seconds])
    frame, part, drop = np.array([int(f) for f in frames]), _fractions(digits), ";" in marks
    second = 60 * minute + seconds
    base, notes = _base(second, frame, part, drop, found)
    if drop and base in _NEVER_DROPPED:
        drop = False
        found.warned.append(
            f"time codes marked as drop-frame, which counts 30 or 60 frames in a second, count "
            f"{base}: read as {base} frames/s without it"
        )
    if _is_millisecond(frame, part, base):
        notes += ("the digits behind the frame number are taken as milliseconds of the second",)
        return _Beats(_past_midnight(second + part, _DAY), 1, False, notes)
    passed = base // 15  # numbers passed over in a minute: 2 of 30, 4 of 60
    if drop and ((minute % 10 > 0) & (seconds == 0) & (frame < passed)).any():
        drop = False
        notes += ("marked as drop-frame, but no number is passed over at a minute: not taken so",)
    elif not drop and base in (30, 60) and _passes(minute, second, second * base + frame, passed):
        drop = True
        notes += (f"{passed} numbers are passed over at each minute: taken as drop-frame",)
    if not drop:
        beats = _past_midnight(second * base + frame + part, _DAY * base)
        return _Beats(beats, base, False, notes)
    beats = second * base + frame - passed * (minute - minute // 10) + part
    notes += (f"drop-frame time code, {base / 1.001:.2f} beats a second",)
    day = _DAY * base - passed * (1440 - 144)
    return _Beats(_past_midnight(beats, day), base, True, notes)


def _passes(minute, second, beats, passed):
    """Whether all minutes but the tenth start so many numbers late, as without a mark as well."""
    step = np.diff(beats)
    turns = (np.diff(minute) == 1) & (np.diff(second) == 1) & (minute[1:] % 10 > 0)
    return bool(turns.any()) and bool((step[turns] - passed == np.median(step)).all())


def _base(second, frame, part, drop, found):
    """Numbers that the code counts in a second, and notes."""
    most = int(frame.max())
    if most >= FASTEST:
        i = int(frame.argmax())
        raise ValueError(
            f"{found.place(i)}: time code {found.codes[i]} counts {most} frames in a "
            f"second; {FASTEST} at most."
        )
    step, turns = np.diff(frame + part), np.diff(second) % _DAY == 1
    # only where a second ends its frames show their number; else 30 or 60 are assumed
    known = (30, 60) if drop else CODED if turns.any() else (30, 60, 120)
    known = [b for b in (*known, FASTEST) if b > most]
    within = step[(np.diff(second) == 0) & (step > 0)]
    if not len(within) or not turns.any():
        guess = f"the take lies within one second: its frames are taken as 1/{known[0]} s"
        return known[0], () if turns.any() else (guess,)
    # from the last frame of a second to the first of the next it is one step as well
    seen = float(np.median(np.median(within) - step[turns]))
    if drop:
        known += [b for b in _NEVER_DROPPED if b > most and abs(b - seen) <= 1]
    else:
        known = [b for b in _BASES if b > most]
    near = min(known, key=lambda b: abs(b - seen))
    return near if drop or abs(near - seen) <= 1.5 else max(round(seen), most + 1), ()


def _is_millisecond(frame, part, base):
    """True where the fraction is the same moment as the frame number: 15.500 of 30."""
    off = np.abs(part * base - frame)
    near = np.minimum(off, base - off) <= 1.5
    return len(np.unique(frame)) >= 5 and bool(near.mean() > 0.95)


# --- which frame a row is -------------------------------------------------------------------------


def _placed(seconds, rough):
    """Frame of each row, the rate, and how many rows come too soon for it."""
    rate = _common(rough, 0.02)
    slots, squeezed = _slots(seconds * rate)
    faults = _faults(slots, squeezed)
    if faults > max(1, 0.02 * len(slots)):  # a single one is a lost frame
        # frames of one rate may be numbered in coarse beats of another: 25 a second in parts of 30
        for other in (r for r in _RATES if 0.55 * rough < r < 1.8 * rough):
            trial, early = _slots(seconds * other)
            if _faults(trial, early) < faults / 4:
                rate, slots, squeezed, faults = other, trial, early, _faults(trial, early)
    return slots, _measured(seconds, slots, rate), squeezed


def _faults(slots, squeezed):
    return squeezed + int(slots[-1]) + 1 - len(slots)


def _slots(at):
    """Whole frames near the times `at`, each row its own, and how many rows come too soon.

    Counted from row to row, for clocks drift, but from where the last ones were on average, for
    single ones jitter.
    """
    slots, phase, squeezed = [0], float(at[0]), 0
    for i, time in enumerate(at[1:].tolist(), 1):
        step = math.ceil(time - phase - 0.52)  # a tie adds no frame
        if step < 1:
            step, squeezed = 1, squeezed + 1
        off = time - phase - step
        phase = time if step > 30 else phase + step + max(0.1, 1 / (i + 1)) * off
        slots.append(slots[-1] + step)
    return np.array(slots), squeezed


def _common(rate, tolerance):
    near = min(_RATES, key=lambda r: abs(r - rate))
    return float(near if abs(near / rate - 1) <= tolerance else rate)


def _measured(seconds, slots, rate):
    """Frames a second over the longest stretch: a common rate where the codes allow it."""
    gaps = np.flatnonzero(np.diff(slots) > LONGEST_FILL * rate) + 1
    i = max(np.split(np.arange(len(slots)), gaps), key=len)
    if len(i) < 3:
        return _common(rate, 0.02)
    x, t = slots[i] - slots[i].mean(), seconds[i] - seconds[i].mean()
    period = x @ t / (x @ x)
    error = 3 * np.std(t - period * x) / np.sqrt(x @ x) / period  # relative, three sigma
    whole = round(1 / period)
    if whole in _BASES and abs(whole * period - 1) <= error:
        return float(whole)
    found = _common(1 / period, max(5e-4, min(0.02, error)))
    return found if found in _RATES else round(found, 3)
