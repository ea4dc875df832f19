"""What an actor does in a take: a sentence, a range of motion, a combination of units."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.actors import ACTORS, actor_number
from data_synth.performance.combinations import N_FACS, draw_units, facs_combinations
from data_synth.performance.emotion import EMOTIONS, emotion_tracks, head_tracks, stress_tracks
from data_synth.performance.manner import apply_manner
from data_synth.performance.script import SENTENCES
from data_synth.performance.speech import coarticulate, sounds
from data_synth.performance.tracks import (
    AT,
    columns,
    envelope,
    join,
    smoothstep,
    wander,
    with_blinks,
)
from data_synth.units import UNITS
from facelab.checks import check_choice, check_number
from facelab.motion import WeightSequence

NECK = np.array([0.0, -75.0, -70.0])
"""Where the head turns, millimetres in the head frame: about the first vertebra."""


@dataclass(frozen=True)
class Performance:
    """What an actor does in one take.

    Parameters
    ----------
    actor, take, text : str
        Who, the name of the take, and what is said or shown.
    weights : WeightSequence
        Of the forty units; its `angles` hold the turns of the head.
    rotation : ndarray of shape (n_frames, 3)
        Turn of the head about `NECK` as a rotation vector, radians.
    sway : ndarray of shape (n_frames, 3)
        Where that point has moved to, millimetres.
    """

    actor: str
    take: str
    text: str
    weights: WeightSequence
    rotation: np.ndarray = field(repr=False)
    sway: np.ndarray = field(repr=False)


def _performance(actor, take, text, W, head, sway, fps):
    """`head` in degrees: yaw to the person's left, pitch up, roll to the left shoulder."""
    yaw, pitch, roll = np.radians(head).T
    turn = Rotation.from_euler("YXZ", np.stack([yaw, -pitch, -roll], axis=1))
    angles = {"HeadYaw": yaw, "HeadPitch": pitch, "HeadRoll": roll}
    # float32 is what is stored: the faces rebuilt from it must be the faces captured
    W = np.clip(apply_manner(W, actor), 0, 1).astype(np.float32).astype(float)
    weights = WeightSequence(W, UNITS, fps, angles=angles)
    return Performance(actor, take, text, weights, turn.as_rotvec(), sway)


def perform_sentence(actor, sentence, fps=120.0, random_state=0):
    """An actor speaks a sentence with its emotion.

    Parameters
    ----------
    actor : str
        One of `data_synth.actors.ACTORS`.
    sentence : str
        One of `SENTENCES`.
    fps : float, default=120
        Frames a second.
    random_state : int
        Equal seeds give equal performances.

    Returns
    -------
    Performance
        2 to 4 seconds.

    Raises
    ------
    ValueError
        For an unknown actor or sentence; the message lists those there are.
    """
    check_choice(actor, "actor", tuple(ACTORS))
    check_choice(sentence, "sentence", tuple(SENTENCES))
    fps = check_number(fps, "fps", low=10)
    number = list(SENTENCES).index(sentence)
    rng = np.random.default_rng([random_state, 1, actor_number(actor), number])
    manner, line = ACTORS[actor].manner, SENTENCES[sentence]
    emotion = EMOTIONS[line.emotion]
    middle, lengths, targets, firm, stressed, seconds = sounds(line, manner, rng)
    t = np.arange(int(seconds * fps)) / fps
    n = len(t)
    size = manner.speech * emotion.speech
    speech = np.clip(size * coarticulate(t, middle, lengths, targets, firm), 0, 1)
    colour = emotion_tracks(emotion, manner, rng, n, fps)
    # speech has the mouth: emotion colours it where the sound leaves room
    closed = speech[:, AT["AU24"]] / 0.55
    for name in ("AU10", "AU16", "AU20"):
        colour[:, columns(name)] *= 1 - 0.6 * np.clip(closed, 0, 1)[:, None]
    for name in ("AU23", "AU24"):
        colour[:, columns(name)] *= 1 - 0.7 * speech[:, AT["AU25"], None]
    beats = middle[stressed]
    beats = beats[rng.random(len(beats)) < 0.75] - 0.03
    accent = stress_tracks(emotion, manner, rng, t, beats)
    tonus = 0.03 * np.abs(wander(rng, n, len(UNITS), fps, 0.25))
    tonus[:, columns("AU45")] = 0
    ends = envelope(n, fps, 0.30, 0.30)[:, None]
    W = ends * join(speech, colour, accent, np.clip(tonus, 0, 0.2))
    W = with_blinks(W, rng, fps, manner.blinks)
    head, sway = head_tracks(emotion, manner, rng, t, beats, ends, fps)
    return _performance(actor, sentence, line.text, W, head, sway, fps)


def perform_facs(actor, number, fps=120.0, random_state=0, seconds=2.05):
    """An actor shows one combination of units: onset, peak, offset.

    Parameters
    ----------
    actor : str
        One of `data_synth.actors.ACTORS`.
    number : int
        1 to 86, of `facs_combinations(random_state)`.
    fps : float, default=120
    random_state : int
    seconds : float, default=2.05
        Length on average.

    Returns
    -------
    Performance
        Its text names the units.
    """
    check_choice(actor, "actor", tuple(ACTORS))
    if not 1 <= number <= N_FACS:
        raise ValueError(f"number={number}, but there are {N_FACS} combinations: 1 to {N_FACS}.")
    rng = np.random.default_rng([random_state, 3, actor_number(actor), number])
    names = facs_combinations(random_state)[number - 1]
    t = np.arange(int(seconds * rng.uniform(0.88, 1.12) * fps)) / fps
    W = np.zeros((len(t), len(UNITS)))
    for name in names:
        start = rng.uniform(0.08, 0.28)
        rise, fall = rng.uniform(0.30, 0.55), rng.uniform(0.35, 0.60)
        end = t[-1] - rng.uniform(0.08, 0.20)
        bump = smoothstep((t - start) / rise) * smoothstep((end - t) / fall)
        hold = 1 + 0.03 * wander(rng, len(t), 1, fps, 0.2)[:, 0]
        W[:, columns(name)] = np.clip(rng.uniform(0.75, 1.0) * bump * hold, 0, 1)[:, None]
    if not any("AU45" in n for n in names):
        W = with_blinks(W, rng, fps, ACTORS[actor].manner.blinks / 2)
    slow = wander(rng, len(t), 6, fps, 0.4)
    head, sway = slow[:, :3] * (1.2, 0.9, 0.7), slow[:, 3:] * (1.5, 0.8, 1.5)
    return _performance(actor, f"facs_{number:02d}", " + ".join(names), W, head, sway, fps)


def perform_rom(actor, fps=120.0, random_state=0, seconds=84.0):
    """A range of motion: one extreme face after the other, every unit taking its turn.

    Parameters
    ----------
    actor : str
        One of `data_synth.actors.ACTORS`.
    fps : float, default=120
    random_state : int
    seconds : float, default=84

    Returns
    -------
    Performance
    """
    check_choice(actor, "actor", tuple(ACTORS))
    seconds = check_number(seconds, "seconds", low=2)
    rng = np.random.default_rng([random_state, 4, actor_number(actor)])
    t = np.arange(int(seconds * fps)) / fps
    turns, keys, times = [], [np.zeros(len(UNITS))], [0.0]
    while times[-1] < t[-1] - 1.6:
        turns = turns or rng.permutation(UNITS).tolist()
        key = np.zeros(len(UNITS))
        if rng.random() > 0.10:  # now and then the face rests
            for name in draw_units(rng, turns.pop(), int(rng.integers(1, 7))):
                key[columns(name)] = rng.uniform(0.6, 1.0)
        keys += [key, key]
        times += [times[-1] + rng.uniform(0.28, 0.65), 0.0]
        times[-1] = times[-2] + rng.uniform(0.05, 0.35)
    keys += [np.zeros(len(UNITS))] * 2
    times += [times[-1] + 0.6, t[-1] + 1.0]
    times, keys = np.array(times), np.array(keys)
    at = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    share = smoothstep((t - times[at]) / (times[at + 1] - times[at]))[:, None]
    W = keys[at] * (1 - share) + keys[at + 1] * share
    W *= np.clip(1 + 0.05 * wander(rng, len(t), len(UNITS), fps, 0.2), 0.8, 1.2)
    W = with_blinks(np.clip(W, 0, 1), rng, fps, ACTORS[actor].manner.blinks)
    slow = wander(rng, len(t), 6, fps, 0.8)
    head, sway = slow[:, :3] * (9.0, 6.0, 4.0), slow[:, 3:] * (8.0, 4.0, 8.0)
    ends = envelope(len(t), fps, 0.5, 0.5)[:, None]
    text = "range of motion"
    return _performance(actor, "rom", text, W, ends * head, ends * sway, fps)
