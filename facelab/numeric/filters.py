"""Low-pass filters for tracks in time: one that looks ahead, one that cannot."""

import numpy as np
from scipy.signal import butter, sosfiltfilt

_ORDER = 2
# two passes of a Butterworth filter of order n have fallen to 1 / sqrt(2) at this share of its
# cut-off (Winter 2009, "Biomechanics and Motor Control of Human Movement", 2.2.4.4)
_TWICE = (np.sqrt(2) - 1) ** (1 / (2 * _ORDER))


def zero_phase(x, fps, cutoff):
    """The tracks smoothed forwards and backwards by a Butterworth filter: no lag at any frequency.

    Parameters
    ----------
    x : ndarray of shape (n_frames, n_tracks)
        Any unit; finite.
    fps : float
        Frames a second.
    cutoff : float
        Hertz at which, both passes together, 1 / sqrt(2) of an oscillation is left.

    Returns
    -------
    ndarray of shape (n_frames, n_tracks)
        Kept within the range of each track, so that a weight that was never negative stays so.

    Raises
    ------
    ValueError
        For a cut-off that the rate cannot hold.
    """
    if not 0 < cutoff < fps / 2:
        raise ValueError(
            f"cutoff={cutoff:g} hertz, but {fps:g} frames a second hold more than 0 and less than "
            f"{fps / 2:g}; choose one between."
        )
    if len(x) < 2:
        return x.copy()
    # frequencies of a digital filter are bent: tan(pi f / fps) stands for f
    edge = np.arctan(np.tan(np.pi * cutoff / fps) / _TWICE) * fps / np.pi
    sections = butter(_ORDER, edge, fs=fps, output="sos")
    # continued beyond its ends, turned over, for as long as the filter remembers
    pad = min(len(x) - 1, int(np.ceil(2 * fps / cutoff)))
    smooth = sosfiltfilt(sections, x, axis=0, padtype="odd", padlen=pad)
    return smooth.clip(x.min(axis=0), x.max(axis=0))


def one_euro(x, fps, cutoff=1.0, beta=0.0, derivative_cutoff=1.0):
    """The tracks smoothed by the One-Euro filter: strongly at rest, hardly when they move fast.

    Parameters
    ----------
    x : ndarray of shape (n_frames, n_tracks)
        Any unit; finite.
    fps : float
        Frames a second.
    cutoff : float, default=1.0
        Hertz, for a track at rest (f_cmin).
    beta : float, default=0.0
        By how much the cut-off rises with speed, hertz for each unit a second.
    derivative_cutoff : float, default=1.0
        Hertz, for the speed itself.

    Returns
    -------
    ndarray of shape (n_frames, n_tracks)
        Each frame from itself and those before it; the first as it is.

    References
    ----------
    Casiez, Roussel and Vogel 2012, "1 Euro Filter: A Simple Speed-based Low-pass Filter for Noisy
    Input in Interactive Systems", CHI, Algorithm 1 and Eq. 3 to 7.
    """
    for name, value in (("cutoff", cutoff), ("derivative_cutoff", derivative_cutoff)):
        if not 0 < value < np.inf:
            raise ValueError(f"{name}={value:g} hertz, but it must be more than 0.")
    if not 0 <= beta < np.inf:
        raise ValueError(f"beta={beta:g}, but it must be 0 or more.")
    low = _share(derivative_cutoff, fps)
    smooth, speed = x.copy(), np.zeros(x.shape[1])
    for i in range(1, len(x)):
        speed = speed + low * ((x[i] - smooth[i - 1]) * fps - speed)
        smooth[i] += (_share(cutoff + beta * np.abs(speed), fps) - 1) * (x[i] - smooth[i - 1])
    return smooth


def _share(cutoff, fps):
    """Share of the new value in a first-order low-pass (alpha, Eq. 6)."""
    return 1 / (1 + fps / (2 * np.pi * cutoff))
