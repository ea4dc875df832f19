"""Emotion: the colour of a whole sentence, stress, and how the head goes along."""

from dataclasses import dataclass, field

import numpy as np

from data_synth.performance.tracks import AT, columns, envelope, pulse, unit_weights, wander
from data_synth.units import UNITS


@dataclass(frozen=True)
class Emotion:
    """What an emotion does to a sentence.

    Parameters
    ----------
    profile, stress : dict of str to float
        Weights of units over the whole sentence, and on top of them at a stressed sound.
    speech : float
        Size of the mouth's movements (1 is average).
    head : tuple of float
        Yaw, pitch (up is positive) and roll, degrees.
    nod : float
        Size of the nods, degrees.
    forward : float
        How far the head is thrust forward, millimetres.
    one_sided : dict of str to float
        Weights on one side, the actor's own.
    """

    profile: dict
    stress: dict
    speech: float
    head: tuple
    nod: float
    forward: float
    one_sided: dict = field(default_factory=dict)


EMOTIONS = {
    "pride": Emotion(
        {"AU12": 0.24, "AU6": 0.14, "AU17": 0.20, "AU14": 0.10, "AU24": 0.08, "AU2": 0.14,
         "AU1": 0.08, "AU7": 0.08, "AU38": 0.10, "AU45": 0.10},
        stress={"AU1": 0.34, "AU2": 0.38},
        speech=0.95, head=(0.0, 7.0, 0.0), nod=2.2, forward=-4.0,
    ),
    "rage": Emotion(
        {"AU4": 0.72, "AU5": 0.48, "AU7": 0.42, "AU9": 0.34, "AU10": 0.34, "AU23": 0.30,
         "AU24": 0.10, "AU17": 0.16, "AU16": 0.16, "AU15": 0.14, "AU20": 0.14, "AU38": 0.45,
         "AU29": 0.18, "AU11": 0.12},
        stress={"AU4": 0.30, "AU9": 0.22, "AU5": 0.20, "AU27": 0.10},
        speech=1.12, head=(0.0, -4.0, 0.0), nod=4.0, forward=14.0,
    ),
    "contempt": Emotion(
        {"AU15": 0.10, "AU17": 0.14, "AU7": 0.16, "AU45": 0.10, "AU4": 0.06, "AU13": 0.05,
         "AU23": 0.06},
        stress={"AU2": 0.30, "AU1": 0.12, "AU10": 0.12},
        speech=0.88, head=(9.0, 4.0, 5.0), nod=1.6, forward=-8.0,
        one_sided={"AU14": 0.60, "AU12": 0.24, "AU10": 0.30, "AU11": 0.16, "AU6": 0.12},
    ),
}  # fmt: skip


def emotion_tracks(emotion, manner, rng, n, fps):
    """The colour of the whole sentence, every unit swelling and fading in its own time."""
    profile = unit_weights(emotion.profile)
    for name, value in emotion.one_sided.items():
        profile[AT[name + manner.sneer]] = value
    profile = profile * rng.uniform(0.75, 1.15) * rng.lognormal(0, 0.18, len(UNITS))
    together = 1 + 0.18 * wander(rng, n, 1, fps, 0.45)
    apart = 1 + 0.28 * wander(rng, n, len(UNITS), fps, 0.30)
    # both sides of a unit swell together, but for a little
    for name in ("AU2", "AU6", "AU7", "AU10", "AU11", "AU12", "AU14", "AU20", "AU45"):
        left, right = columns(name)
        apart[:, right] = 0.8 * apart[:, left] + 0.2 * apart[:, right]
    wanted = np.maximum(profile * together * apart, 0)
    return wanted / (1 + wanted**4) ** 0.25 * envelope(n, fps, 0.5, 0.45)[:, None]


def stress_tracks(emotion, manner, rng, t, beats):
    """Weights that mark the stressed sounds, shape (n_frames, 40)."""
    accent = np.zeros((len(t), len(UNITS)))
    for at in beats:
        bump = pulse(t, at, 0.16, 0.30)[:, None]
        accent = np.maximum(accent, bump * rng.uniform(0.5, 1.1) * unit_weights(emotion.stress))
    if emotion.one_sided:
        other = "R" if manner.sneer == "L" else "L"
        accent[:, [AT[f"AU2{other}"], AT[f"AU10{other}"]]] *= 0.25
    return np.clip(accent, 0, 0.9)


def head_tracks(emotion, manner, rng, t, beats, ends, fps):
    """Yaw, pitch and roll in degrees, and sway in millimetres, each of shape (n_frames, 3)."""
    side = 1 if manner.sneer == "L" else -1
    bias = np.array(emotion.head) * (side, 1, side)
    slow = wander(rng, len(t), 6, fps, 0.35)
    head = ends * bias + manner.head * slow[:, :3] * (2.4, 1.5, 1.2)
    for at in beats:
        head[:, 1] -= manner.head * emotion.nod * rng.uniform(0.5, 1.2) * pulse(t, at, 0.18, 0.26)
    sway = manner.head * slow[:, 3:] * (3.0, 1.5, 3.0) + ends * (0, 0, emotion.forward)
    return head, sway
