"""Tracks of weights in time: noise, bumps, envelopes, blinks, and how they join."""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_synth.units import UNITS, expand

AT = {name: k for k, name in enumerate(UNITS)}
"""Column of each unit in an array of weights."""


def columns(name):
    """Columns of a unit, or of both its sides for a name without one: list of int."""
    return [AT[u] for u in expand(name)]


def unit_weights(profile):
    """Weights of all units, shape (40,), from names; a name without side drives both sides."""
    w = np.zeros(len(UNITS))
    for name, value in profile.items():
        w[columns(name)] = value
    return w


def join(*parts):
    """Weights that act together: 1 - prod(1 - w), within [0, 1]."""
    rest = 1.0
    for w in parts:
        rest = rest * (1 - w)
    return 1 - rest


def smoothstep(x):
    """0 below 0, 1 above 1, no speed at either end (minimum jerk)."""
    x = np.clip(x, 0, 1)
    return x**3 * (10 - 15 * x + 6 * x**2)


def wander(rng, n_frames, n_columns, fps, seconds):
    """Slow noise of unit variance with that correlation time, shape (n_frames, n_columns)."""
    sigma = seconds * fps
    pad = int(4 * sigma) + 1
    white = rng.normal(size=(n_frames + 2 * pad, n_columns))
    smooth = gaussian_filter1d(white, sigma, axis=0, mode="constant")[pad : pad + n_frames]
    return smooth * np.sqrt(2 * sigma * np.sqrt(np.pi))


def envelope(n_frames, fps, rise, fall):
    """0 at both ends, 1 between."""
    t = np.arange(n_frames) / fps
    return smoothstep(t / rise) * smoothstep((t[-1] - t) / fall)


def blinks(rng, n_frames, fps, per_minute):
    """Lids closed by blinks, shape (n_frames,): shut in 80 ms, open in 150 ms."""
    t = np.arange(n_frames) / fps
    lids = np.zeros(n_frames)
    at = rng.exponential(60 / per_minute) * 0.5 + 0.2
    while at < t[-1] - 0.3:
        shut, opened = at + 0.08, at + 0.08 + rng.uniform(0.02, 0.05)
        depth = rng.uniform(0.9, 1.0)
        shape = smoothstep((t - at) / 0.08) * (1 - smoothstep((t - opened) / 0.15))
        lids = np.maximum(lids, depth * np.where(t < shut, smoothstep((t - at) / 0.08), shape))
        at += 0.45 + rng.exponential(max(60 / per_minute - 0.45, 0.1))
    return lids


def with_blinks(W, rng, fps, per_minute):
    """The lids join in: while they close, the raised lid gives way."""
    late = max(1, round(0.006 * fps))
    lids = blinks(rng, len(W), fps, per_minute)
    both = {"AU45L": lids, "AU45R": np.append(np.zeros(late), lids[:-late])}
    for name, blink in both.items():
        W[:, AT[name]] = np.maximum(W[:, AT[name]], blink)
    W[:, AT["AU5"]] *= 1 - lids
    return W


def pulse(t, at, rise, fall):
    """A bump of height 1 at a time, shape (n_frames,)."""
    return smoothstep((t - at + rise) / rise) * smoothstep((at + fall - t) / fall)
