"""What the four actors do: sentences with an emotion, a range of motion, FACS combinations.

A performance is a weight for each action unit and a pose of the head in each frame. Speech,
emotion, stress and blinks are made apart and joined so that a weight never leaves [0, 1]; then
the actor's own manner is laid over them: strength, asymmetry and coupling of units.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from data_synth.units import UNITS, expand
from facelab.checks import check_choice, check_number
from facelab.motion import WeightSequence

ACTORS = ("M1", "F1", "M2", "F2")
EMOTIONS = ("pride", "rage", "contempt")
N_FACS = 86
NECK = np.array([0.0, -75.0, -70.0])
"""Where the head turns, millimetres in the head frame: about the first vertebra."""

_AT = {name: k for k, name in enumerate(UNITS)}


def _columns(name):
    return [_AT[u] for u in expand(name)]


def _weights(profile):
    """Weights of all units, shape (40,), from names; a name without side drives both sides."""
    w = np.zeros(len(UNITS))
    for name, value in profile.items():
        w[_columns(name)] = value
    return w


# --- sentences ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sentence:
    """A line of the script.

    Parameters
    ----------
    name : str
        `pride_1` to `contempt_6`.
    text : str
    phones : tuple of str
        ARPAbet; a vowel ends in 1 where it is stressed; `|` is a short pause.
    """

    name: str
    text: str
    phones: tuple

    @property
    def emotion(self):
        """One of `EMOTIONS`."""
        return self.name.split("_")[0]

    @property
    def split(self):
        """`train` for the first four of each emotion, `test` for the last two."""
        return "train" if int(self.name.split("_")[1]) <= 4 else "test"


_SCRIPT = {
    "pride_1": ("We built this bridge with our own hands.",
                "W IY B IH1 L T DH IH S B R IH1 JH W IH DH AW ER OW1 N HH AE1 N D Z"),
    "pride_2": ("My daughter was the first one over the line.",
                "M AY D AO1 T ER W AH Z DH AH F ER1 S T W AH N OW1 V ER DH AH L AY1 N"),
    "pride_3": ("Nobody thought it could fly, | and look at it now.",
                "N OW1 B AA D IY TH AO1 T IH T K UH D F L AY1 | AE N D L UH1 K AE T IH T N AW1"),
    "pride_4": ("Forty years, and I never missed a show.",
                "F AO1 R T IY Y IH1 R Z | AE N D AY N EH1 V ER M IH1 S T AH SH OW1"),
    "pride_5": ("You may put my name above the door.",
                "Y UW M EY P UH1 T M AY N EY1 M AH B AH1 V DH AH D AO1 R"),
    "pride_6": ("They said it was hopeless, and we finished early.",
                "DH EY S EH1 D IH T W AH Z HH OW1 P L AH S | AE N D W IY F IH1 N IH SH T ER1 L IY"),
    "rage_1": ("Who gave you the right to open that letter?",
               "HH UW1 G EY1 V Y UW DH AH R AY1 T T UW OW1 P AH N DH AE T L EH1 T ER"),
    "rage_2": ("Get your boots off my father's grave!",
               "G EH1 T Y AO R B UW1 T S AO1 F M AY F AA1 DH ER Z G R EY1 V"),
    "rage_3": ("You sold the farm, and you shook my hand.",
               "Y UW S OW1 L D DH AH F AA1 R M | AE N D Y UW SH UH1 K M AY HH AE1 N D"),
    "rage_4": ("I have been waiting in the rain for three hours!",
               "AY HH AE V B IH N W EY1 T IH NG IH N DH AH R EY1 N F AO R TH R IY1 AW1 ER Z"),
    "rage_5": ("Break one more promise and we are finished!",
               "B R EY1 K W AH1 N M AO1 R P R AA1 M IH S AE N D W IY AA R F IH1 N IH SH T"),
    "rage_6": ("Shut up, just shut up and move your car!",
               "SH AH1 T AH1 P | JH AH S T SH AH1 T AH1 P AE N D M UW1 V Y AO R K AA1 R"),
    "contempt_1": ("How charming, he owns a second shirt.",
                   "HH AW1 CH AA1 R M IH NG | HH IY OW1 N Z AH S EH1 K AH N D SH ER1 T"),
    "contempt_2": ("I would not trust him to boil water.",
                   "AY W UH D N AA1 T T R AH1 S T HH IH M T UW B OY1 L W AO1 T ER"),
    "contempt_3": ("Of course you forgot, you always do.",
                   "AH V K AO1 R S Y UW F ER G AA1 T | Y UW AO1 L W EY Z D UW1"),
    "contempt_4": ("Was that a speech, or were you clearing your throat?",
                   "W AH Z DH AE1 T AH S P IY1 CH | AO R W ER Y UW K L IH1 R IH NG Y AO R "
                   "TH R OW1 T"),
    "contempt_5": ("Please, show us your famous method again.",
                   "P L IY1 Z | SH OW1 AH S Y AO R F EY1 M AH S M EH1 TH AH D AH G EH1 N"),
    "contempt_6": ("A child could paint it, and a child did.",
                   "AH CH AY1 L D K UH D P EY1 N T IH T | AE N D AH CH AY1 L D D IH1 D"),
}  # fmt: skip

SENTENCES = {
    name: Sentence(name, text.replace("| ", ""), tuple(phones.split()))
    for name, (text, phones) in _SCRIPT.items()
}
"""The eighteen sentences by name: six of each emotion, four to train on and two to test."""

# What the mouth aims at: unit weights, seconds, and how firmly it holds against its neighbours.
# AU25 parts the lips, AU26 and AU27 drop the jaw.
_VISEMES = {
    "P B M": ({"AU24": 0.55, "AU17": 0.22, "AU23": 0.12}, 0.085, 3.0),
    "F V": ({"AU28": 0.22, "AU17": 0.18, "AU10": 0.14, "AU25": 0.08, "AU26": 0.05}, 0.095, 2.2),
    "TH DH": ({"AU25": 0.42, "AU26": 0.14, "AU16": 0.08}, 0.08, 1.0),
    "T D N": ({"AU25": 0.36, "AU26": 0.10, "AU20": 0.06}, 0.065, 0.7),
    "S Z": ({"AU25": 0.40, "AU26": 0.04, "AU20": 0.18, "AU16": 0.10}, 0.095, 1.3),
    "SH CH JH": ({"AU22": 0.62, "AU25": 0.38, "AU26": 0.07, "AU18": 0.15}, 0.10, 1.8),
    "K G NG HH": ({"AU25": 0.34, "AU26": 0.18}, 0.07, 0.5),
    "L": ({"AU25": 0.42, "AU26": 0.22, "AU16": 0.08}, 0.07, 0.7),
    "R": ({"AU18": 0.30, "AU22": 0.28, "AU25": 0.26, "AU26": 0.14}, 0.075, 1.0),
    "W": ({"AU18": 0.78, "AU25": 0.12, "AU26": 0.10}, 0.08, 1.8),
    "Y": ({"AU25": 0.40, "AU26": 0.10, "AU20": 0.22}, 0.06, 0.7),
    "AA": ({"AU26": 0.78, "AU27": 0.16, "AU25": 0.58, "AU16": 0.10}, 0.115, 1.2),
    "AE": ({"AU26": 0.60, "AU27": 0.06, "AU25": 0.60, "AU20": 0.24, "AU10": 0.10}, 0.115, 1.2),
    "AH": ({"AU26": 0.36, "AU25": 0.42}, 0.07, 0.8),
    "AO": ({"AU26": 0.56, "AU18": 0.34, "AU22": 0.26, "AU25": 0.40}, 0.11, 1.2),
    "EH": ({"AU26": 0.44, "AU25": 0.55, "AU20": 0.20, "AU16": 0.06}, 0.095, 1.0),
    "ER": ({"AU18": 0.32, "AU22": 0.18, "AU26": 0.24, "AU25": 0.34}, 0.095, 1.0),
    "IH": ({"AU26": 0.24, "AU25": 0.46, "AU20": 0.18}, 0.075, 0.8),
    "IY": ({"AU26": 0.12, "AU25": 0.48, "AU20": 0.46, "AU16": 0.10}, 0.105, 1.2),
    "UH": ({"AU18": 0.46, "AU26": 0.26, "AU25": 0.30}, 0.08, 1.0),
    "UW": ({"AU18": 0.82, "AU22": 0.26, "AU26": 0.14, "AU25": 0.18}, 0.11, 1.5),
    "|": ({"AU25": 0.06}, 0.20, 0.6),
}  # fmt: skip
_VISEME = {
    phone: (_weights(units), seconds, firm)
    for phones, (units, seconds, firm) in _VISEMES.items()
    for phone in phones.split()
}
_DIPHTHONGS = {
    "AY": ("AA", "IH"), "AW": ("AA", "UH"), "OY": ("AO", "IH"), "EY": ("EH", "IY"),
    "OW": ("AO", "UW"),
}  # fmt: skip
_SPEECH_UNITS = sorted({k for w, _, _ in _VISEME.values() for k in np.flatnonzero(w)})

# --- emotions: unit weights over the whole sentence, stress, head ---------------------------------

_PROFILES = {
    "pride": {"AU12": 0.24, "AU6": 0.14, "AU17": 0.20, "AU14": 0.10, "AU24": 0.08, "AU2": 0.14,
              "AU1": 0.08, "AU7": 0.08, "AU38": 0.10, "AU45": 0.10},
    "rage": {"AU4": 0.72, "AU5": 0.48, "AU7": 0.42, "AU9": 0.34, "AU10": 0.34, "AU23": 0.30,
             "AU24": 0.10, "AU17": 0.16, "AU16": 0.16, "AU15": 0.14, "AU20": 0.14, "AU38": 0.45,
             "AU29": 0.18, "AU11": 0.12},
    "contempt": {"AU15": 0.10, "AU17": 0.14, "AU7": 0.16, "AU45": 0.10, "AU4": 0.06, "AU13": 0.05,
                 "AU23": 0.06},
}  # fmt: skip
_ONE_SIDED = {"contempt": {"AU14": 0.60, "AU12": 0.24, "AU10": 0.30, "AU11": 0.16, "AU6": 0.12}}
_STRESS = {
    "pride": {"AU1": 0.34, "AU2": 0.38},
    "rage": {"AU4": 0.30, "AU9": 0.22, "AU5": 0.20, "AU27": 0.10},
    "contempt": {"AU2": 0.30, "AU1": 0.12, "AU10": 0.12},
}
_LIMP = ("AU45", "AU5")  # weights that a blink overrules
# yaw, pitch (up is positive), roll in degrees; size of the nods in degrees; forward in mm
_HEAD = {
    "pride": ((0.0, 7.0, 0.0), 2.2, -4.0),
    "rage": ((0.0, -4.0, 0.0), 4.0, 14.0),
    "contempt": ((9.0, 4.0, 5.0), 1.6, -8.0),
}

# --- the actors' manner ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Manner:
    """How one actor moves, the same in every take and for every `random_state`.

    Parameters
    ----------
    gains : dict of str to float
        Strength of a unit, 0 to 1; the others have `strength`.
    strength : float
        Strength of units in general, 0 to 1.
    couplings : dict of (str, str) to float
        How much of the first unit the second one brings along with it, 0 to 1.
    weak_side : str
        "L" or "R": the side of the face that lags behind.
    asymmetry : float
        Share by which it does.
    speech, tempo : float
        Size of the mouth's movements in speech, and its pace (1 is average).
    blinks : float
        Blinks a minute.
    sneer : str
        "L" or "R": the side of contempt.
    head : float
        Size of the head's movements (1 is average).
    """

    strength: float
    gains: dict
    couplings: dict
    weak_side: str
    asymmetry: float
    speech: float
    tempo: float
    blinks: float
    sneer: str
    head: float


MANNERS = {
    # a stage actor: large in all, brows and nose move together, left corner strong
    "M1": Manner(0.96, {"AU11": 0.8, "AU34": 0.9},
                 {("AU4", "AU9"): 0.16, ("AU9", "AU10"): 0.14, ("AU1", "AU2"): 0.12,
                  ("AU12", "AU6"): 0.14}, "R", 0.12, 1.0, 1.0, 17, "L", 1.0),
    # lively brows, quick; smiles reach the eyes
    "F1": Manner(0.92, {"AU1": 1.0, "AU2": 1.0, "AU9": 0.7, "AU15": 0.8, "AU27": 0.85},
                 {("AU1", "AU2"): 0.32, ("AU12", "AU6"): 0.34, ("AU5", "AU1"): 0.18,
                  ("AU20", "AU12"): 0.12}, "L", 0.07, 0.92, 1.12, 21, "R", 1.25),
    # restrained; the upper lip hardly moves, the chin works instead
    "M2": Manner(0.76, {"AU10": 0.55, "AU4": 0.95, "AU17": 0.95, "AU2": 0.55, "AU6": 0.6},
                 {("AU4", "AU7"): 0.30, ("AU15", "AU17"): 0.30, ("AU12", "AU14"): 0.24,
                  ("AU10", "AU17"): 0.14}, "R", 0.05, 0.74, 0.94, 12, "L", 0.7),
    # a mobile mouth, clearly lopsided; the forehead moves as one
    "F2": Manner(0.86, {"AU12": 1.0, "AU20": 1.0, "AU22": 1.0, "AU26": 1.0, "AU9": 0.6},
                 {("AU1", "AU4"): 0.16, ("AU12", "AU10"): 0.18, ("AU14", "AU12"): 0.26,
                  ("AU17", "AU15"): 0.26}, "L", 0.20, 1.0, 1.03, 15, "R", 0.9),
}  # fmt: skip


def manner_matrix(actor):
    """Strength, asymmetry and coupling of an actor's units as one matrix.

    Parameters
    ----------
    actor : str
        One of `ACTORS`.

    Returns
    -------
    A : ndarray of shape (40, 40)
        A[i, j] is how much unit j moves when unit i is wanted; the diagonal holds the strengths.
        All within [0, 1].
    """
    check_choice(actor, "actor", ACTORS)
    manner = MANNERS[actor]
    strength = np.full(len(UNITS), manner.strength)
    for name, gain in manner.gains.items():
        strength[_columns(name)] = gain
    # lids must close, jaw and lips must do what speech asks
    strength[_columns("AU45")] = 1.0
    one = np.random.default_rng(700 + ACTORS.index(actor)).uniform(0.94, 1.0, len(UNITS))
    strength *= np.where(np.isin(UNITS, expand("AU45")), 1.0, one)
    weak = [k for k, name in enumerate(UNITS) if name[-1] == manner.weak_side and "45" not in name]
    strength[weak] *= 1 - manner.asymmetry
    A = np.diag(strength)
    for (cause, effect), share in manner.couplings.items():
        for i in _columns(cause):
            for j in _columns(effect):
                opposite = {UNITS[i][-1], UNITS[j][-1]} == {"L", "R"}
                A[i, j] = max(A[i, j], 0.0 if opposite else share)
    return A


def apply_manner(weights, actor):
    """Weights as an actor performs them: shape (n_frames, 40), within [0, 1] like those given.

    Contributions join as chances do, 1 - prod(1 - A[i, j] w[i]): they add up while small and
    never exceed 1.
    """
    A = manner_matrix(actor)
    rest = np.ones_like(weights)
    for i in range(len(UNITS)):
        to = np.flatnonzero(A[i])
        rest[:, to] *= 1 - A[i, to] * weights[:, i : i + 1]
    return 1 - rest


# --- building blocks ------------------------------------------------------------------------------


def _join(*parts):
    """Weights that act together: 1 - prod(1 - w), within [0, 1]."""
    rest = 1.0
    for w in parts:
        rest = rest * (1 - w)
    return 1 - rest


def _smoothstep(x):
    """0 below 0, 1 above 1, no speed at either end (minimum jerk)."""
    x = np.clip(x, 0, 1)
    return x**3 * (10 - 15 * x + 6 * x**2)


def _wander(rng, n_frames, n_columns, fps, seconds):
    """Slow noise of unit variance with that correlation time, shape (n_frames, n_columns)."""
    sigma = seconds * fps
    pad = int(4 * sigma) + 1
    white = rng.normal(size=(n_frames + 2 * pad, n_columns))
    smooth = gaussian_filter1d(white, sigma, axis=0, mode="constant")[pad : pad + n_frames]
    return smooth * np.sqrt(2 * sigma * np.sqrt(np.pi))


def _envelope(n_frames, fps, rise, fall):
    """0 at both ends, 1 between."""
    t = np.arange(n_frames) / fps
    return _smoothstep(t / rise) * _smoothstep((t[-1] - t) / fall)


def _phones(sentence, manner, rng):
    """Visemes of a sentence in time: middle (s), length (s), target (S, 40), firmness, stress."""
    lengths, targets, firm, stress = [], [], [], []
    for phone in sentence.phones:
        stressed = phone.endswith("1")
        sound = phone.rstrip("1")
        parts = _DIPHTHONGS.get(sound, (sound,))
        for part in parts:
            target, seconds, hold = _VISEME[part]
            # a stressed vowel is longer and fuller; an unstressed one is on its way elsewhere
            vowel = part[0] in "AEIOU"
            size = (1.12 if stressed else 0.8) if vowel else 1.0
            pace = (1.35 if stressed else 0.85) if vowel else 1.0
            lengths.append(seconds * pace * (0.72 if len(parts) > 1 else 1.0))
            targets.append(np.minimum(target * size, 1))
            firm.append(hold)
            stress.append(stressed and part is parts[0])
    lengths = np.array(lengths) * rng.lognormal(0, 0.12, len(lengths)) * 1.04 / manner.tempo
    lead, tail = 0.35, 0.40  # the sentence lasts 2 to 4 s with its silences
    lengths *= np.clip(lengths.sum(), 2.0 - lead - tail + 0.05, 4.0 - lead - tail - 0.05) / (
        lengths.sum()
    )
    ends = lead + np.cumsum(lengths)
    middle = ends - lengths / 2
    return middle, lengths, np.array(targets), np.array(firm), np.array(stress), ends[-1] + tail


def coarticulate(t, middle, lengths, targets, firm):
    """Tracks of the mouth in which every sound leans towards its neighbours.

    Parameters
    ----------
    t : ndarray of shape (n_frames,)
        Seconds.
    middle, lengths : ndarray of shape (n_sounds,)
        Seconds.
    targets : ndarray of shape (n_sounds, n_units)
    firm : ndarray of shape (n_sounds,)
        How much a sound holds against its neighbours.

    Returns
    -------
    W : ndarray of shape (n_frames, n_units)
        sum(D T) / sum(D) with dominances D = firm * exp(-|t - middle| / tau), tau a share of
        the length; silence has a small dominance always.

    References
    ----------
    Cohen and Massaro, Modeling coarticulation in synthetic visual speech, 1993.
    """
    tau = 0.40 * lengths
    away = np.abs(t[:, None] - middle) / tau
    D = firm * np.exp(-(away**1.25))  # (n_frames, n_sounds)
    return (D @ targets) / (D.sum(axis=1, keepdims=True) + 0.04)


def _blinks(rng, n_frames, fps, per_minute):
    """Lids closed by blinks, shape (n_frames,): shut in 80 ms, open in 150 ms."""
    t = np.arange(n_frames) / fps
    lids = np.zeros(n_frames)
    at = rng.exponential(60 / per_minute) * 0.5 + 0.2
    while at < t[-1] - 0.3:
        shut, opened = at + 0.08, at + 0.08 + rng.uniform(0.02, 0.05)
        depth = rng.uniform(0.9, 1.0)
        pulse = _smoothstep((t - at) / 0.08) * (1 - _smoothstep((t - opened) / 0.15))
        lids = np.maximum(lids, depth * np.where(t < shut, _smoothstep((t - at) / 0.08), pulse))
        at += 0.45 + rng.exponential(max(60 / per_minute - 0.45, 0.1))
    return lids


def _with_blinks(W, rng, fps, per_minute):
    """The lids join in: while they close, the raised lid gives way."""
    late = max(1, round(0.006 * fps))
    lids = _blinks(rng, len(W), fps, per_minute)
    both = {"AU45L": lids, "AU45R": np.append(np.zeros(late), lids[:-late])}
    for name, blink in both.items():
        W[:, _AT[name]] = np.maximum(W[:, _AT[name]], blink)
    W[:, _AT["AU5"]] *= 1 - lids
    return W


def _pulses(t, times, rise, fall):
    """A bump of height 1 at each time, shape (n_frames,)."""
    track = np.zeros(len(t))
    for at in times:
        up, down = _smoothstep((t - at + rise) / rise), _smoothstep((at + fall - t) / fall)
        track = np.maximum(track, up * down)
    return track


# --- a performance --------------------------------------------------------------------------------


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
        One of `ACTORS`.
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
    check_choice(actor, "actor", ACTORS)
    check_choice(sentence, "sentence", tuple(SENTENCES))
    fps = check_number(fps, "fps", low=10)
    number = list(SENTENCES).index(sentence)
    rng = np.random.default_rng([random_state, 1, ACTORS.index(actor), number])
    manner, line = MANNERS[actor], SENTENCES[sentence]
    middle, lengths, targets, firm, stressed, seconds = _phones(line, manner, rng)
    t = np.arange(int(seconds * fps)) / fps
    n = len(t)
    size = manner.speech * {"pride": 0.95, "rage": 1.12, "contempt": 0.88}[line.emotion]
    speech = np.clip(size * coarticulate(t, middle, lengths, targets, firm), 0, 1)
    emotion = _emotion(line.emotion, manner, rng, n, fps)
    # speech has the mouth: emotion colours it where the sound leaves room
    closed = speech[:, _AT["AU24"]] / 0.55
    for name in ("AU10", "AU16", "AU20"):
        emotion[:, _columns(name)] *= 1 - 0.6 * np.clip(closed, 0, 1)[:, None]
    for name in ("AU23", "AU24"):
        emotion[:, _columns(name)] *= 1 - 0.7 * speech[:, _AT["AU25"], None]
    beats = middle[stressed]
    beats = beats[rng.random(len(beats)) < 0.75] - 0.03
    accent = np.zeros((n, len(UNITS)))
    for at in beats:
        bump = _pulses(t, [at], 0.16, 0.30)[:, None]
        accent = np.maximum(accent, bump * rng.uniform(0.5, 1.1) * _weights(_STRESS[line.emotion]))
    if line.emotion == "contempt":
        other = "R" if manner.sneer == "L" else "L"
        accent[:, [_AT[f"AU2{other}"], _AT[f"AU10{other}"]]] *= 0.25
    tonus = 0.03 * np.abs(_wander(rng, n, len(UNITS), fps, 0.25))
    tonus[:, _columns("AU45")] = 0
    ends = _envelope(n, fps, 0.30, 0.30)[:, None]
    W = ends * _join(speech, emotion, np.clip(accent, 0, 0.9), np.clip(tonus, 0, 0.2))
    W = _with_blinks(W, rng, fps, manner.blinks)
    head, sway = _head(line.emotion, manner, rng, t, beats, ends, fps)
    return _performance(actor, sentence, line.text, W, head, sway, fps)


def _emotion(emotion, manner, rng, n, fps):
    """The colour of the whole sentence, every unit swelling and fading in its own time."""
    profile = _weights(_PROFILES[emotion])
    for name, value in _ONE_SIDED.get(emotion, {}).items():
        profile[_AT[name + manner.sneer]] = value
    profile = profile * rng.uniform(0.75, 1.15) * rng.lognormal(0, 0.18, len(UNITS))
    together = 1 + 0.18 * _wander(rng, n, 1, fps, 0.45)
    apart = 1 + 0.28 * _wander(rng, n, len(UNITS), fps, 0.30)
    # both sides of a unit swell together, but for a little
    for name in ("AU2", "AU6", "AU7", "AU10", "AU11", "AU12", "AU14", "AU20", "AU45"):
        left, right = _columns(name)
        apart[:, right] = 0.8 * apart[:, left] + 0.2 * apart[:, right]
    wanted = np.maximum(profile * together * apart, 0)
    return wanted / (1 + wanted**4) ** 0.25 * _envelope(n, fps, 0.5, 0.45)[:, None]


def _head(emotion, manner, rng, t, beats, ends, fps):
    """Yaw, pitch and roll in degrees, and sway in millimetres, each of shape (n_frames, 3)."""
    bias, nod, forward = _HEAD[emotion]
    bias = np.array(bias) * (1, 1, 1 if manner.sneer == "L" else -1)
    bias = bias * (-1 if manner.sneer == "R" else 1, 1, 1)
    slow = _wander(rng, len(t), 6, fps, 0.35)
    head = ends * bias + manner.head * slow[:, :3] * (2.4, 1.5, 1.2)
    for at in beats:
        head[:, 1] -= manner.head * nod * rng.uniform(0.5, 1.2) * _pulses(t, [at], 0.18, 0.26)
    sway = manner.head * slow[:, 3:] * (3.0, 1.5, 3.0) + ends * (0, 0, forward)
    return head, sway


# --- range of motion and FACS combinations --------------------------------------------------------

_OPPOSED = [
    ("AU25", "AU24"), ("AU25", "AU28"), ("AU26", "AU24"), ("AU26", "AU28"), ("AU27", "AU24"),
    ("AU27", "AU28"), ("AU27", "AU23"), ("AU26", "AU23"), ("AU26", "AU27"), ("AU25", "AU27"),
    ("AU25", "AU26"), ("AU27", "AU17"), ("AU18", "AU20"), ("AU18", "AU12"), ("AU18", "AU24"),
    ("AU18", "AU28"), ("AU18", "AU14"), ("AU18", "AU13"), ("AU22", "AU20"), ("AU22", "AU24"),
    ("AU22", "AU28"), ("AU22", "AU12"), ("AU22", "AU23"), ("AU22", "AU13"), ("AU22", "AU18"),
    ("AU27", "AU18"), ("AU27", "AU22"), ("AU27", "AU16"), ("AU27", "AU15"), ("AU28", "AU16"),
    ("AU28", "AU10"), ("AU28", "AU24"), ("AU28", "AU23"), ("AU34", "AU35"), ("AU34", "AU25"),
    ("AU34", "AU26"), ("AU34", "AU27"), ("AU34", "AU16"), ("AU34", "AU28"), ("AU34", "AU14"),
    ("AU35", "AU27"), ("AU35", "AU12"), ("AU35", "AU20"), ("AU13", "AU15"), ("AU12", "AU13"),
    ("AU17", "AU16"), ("AU16", "AU24"), ("AU5", "AU45"), ("AU5", "AU6"), ("AU29", "AU27"),
    ("AU30L", "AU30R"), ("AU29", "AU30L"), ("AU29", "AU30R"), ("AU27", "AU30L"),
    ("AU27", "AU30R"), ("AU15", "AU22"), ("AU10", "AU24"), ("AU11", "AU24"), ("AU20", "AU23"),
]  # fmt: skip
_OPPOSED = {frozenset((_AT[a], _AT[b])) for x, y in _OPPOSED for a in expand(x) for b in expand(y)}
_SIDED = ("AU2", "AU6", "AU7", "AU45", "AU10", "AU11", "AU12", "AU14", "AU20")
_WHOLE = tuple(dict.fromkeys(u[:-1] if u[:-1] in _SIDED else u for u in UNITS))


def _draw_units(rng, first, count):
    """Up to `count` names that one face can show together, the first one given."""
    chosen = [first]
    for name in rng.permutation(_WHOLE).tolist():
        if len(chosen) == count:
            break
        if name in _SIDED and rng.random() < 0.3:
            name += "LR"[rng.integers(2)]
        taken = [k for c in chosen for k in _columns(c)]
        if not set(taken) & set(_columns(name)) and not any(
            frozenset((a, b)) in _OPPOSED for a in taken for b in _columns(name)
        ):
            chosen.append(name)
    return sorted(chosen, key=lambda c: _columns(c)[0])


def facs_combinations(random_state=0):
    """The 86 combinations of units that M1 shows: tuples of 1 to 4 names, each combination once.

    The forty units alone come first; then combinations of units that one face can show
    together, both sides of a unit as one name (`AU12`) or one side alone (`AU12L`).
    """
    rng = np.random.default_rng([random_state, 2])
    found = [(name,) for name in UNITS]
    while len(found) < N_FACS:
        names = tuple(_draw_units(rng, str(rng.choice(_WHOLE)), int(rng.integers(2, 5))))
        if names not in found and len(names) > 1:
            found.append(names)
    return tuple(found)


def perform_facs(actor, number, fps=120.0, random_state=0, seconds=2.05):
    """An actor shows one combination of units: onset, peak, offset.

    Parameters
    ----------
    actor : str
        One of `ACTORS`.
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
    check_choice(actor, "actor", ACTORS)
    if not 1 <= number <= N_FACS:
        raise ValueError(f"number={number}, but there are {N_FACS} combinations: 1 to {N_FACS}.")
    rng = np.random.default_rng([random_state, 3, ACTORS.index(actor), number])
    names = facs_combinations(random_state)[number - 1]
    t = np.arange(int(seconds * rng.uniform(0.88, 1.12) * fps)) / fps
    W = np.zeros((len(t), len(UNITS)))
    for name in names:
        start = rng.uniform(0.08, 0.28)
        rise, fall = rng.uniform(0.30, 0.55), rng.uniform(0.35, 0.60)
        end = t[-1] - rng.uniform(0.08, 0.20)
        bump = _smoothstep((t - start) / rise) * _smoothstep((end - t) / fall)
        hold = 1 + 0.03 * _wander(rng, len(t), 1, fps, 0.2)[:, 0]
        W[:, _columns(name)] = np.clip(rng.uniform(0.75, 1.0) * bump * hold, 0, 1)[:, None]
    if not any("AU45" in n for n in names):
        W = _with_blinks(W, rng, fps, MANNERS[actor].blinks / 2)
    slow = _wander(rng, len(t), 6, fps, 0.4)
    head, sway = slow[:, :3] * (1.2, 0.9, 0.7), slow[:, 3:] * (1.5, 0.8, 1.5)
    return _performance(actor, f"facs_{number:02d}", " + ".join(names), W, head, sway, fps)


def perform_rom(actor, fps=120.0, random_state=0, seconds=84.0):
    """A range of motion: one extreme face after the other, every unit taking its turn.

    Parameters
    ----------
    actor : str
        One of `ACTORS`.
    fps : float, default=120
    random_state : int
    seconds : float, default=84

    Returns
    -------
    Performance
    """
    check_choice(actor, "actor", ACTORS)
    seconds = check_number(seconds, "seconds", low=2)
    rng = np.random.default_rng([random_state, 4, ACTORS.index(actor)])
    t = np.arange(int(seconds * fps)) / fps
    turns, keys, times = [], [np.zeros(len(UNITS))], [0.0]
    while times[-1] < t[-1] - 1.6:
        turns = turns or rng.permutation(UNITS).tolist()
        key = np.zeros(len(UNITS))
        if rng.random() > 0.10:  # now and then the face rests
            for name in _draw_units(rng, turns.pop(), int(rng.integers(1, 7))):
                key[_columns(name)] = rng.uniform(0.6, 1.0)
        keys += [key, key]
        times += [times[-1] + rng.uniform(0.28, 0.65), 0.0]
        times[-1] = times[-2] + rng.uniform(0.05, 0.35)
    keys += [np.zeros(len(UNITS))] * 2
    times += [times[-1] + 0.6, t[-1] + 1.0]
    times, keys = np.array(times), np.array(keys)
    at = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    share = _smoothstep((t - times[at]) / (times[at + 1] - times[at]))[:, None]
    W = keys[at] * (1 - share) + keys[at + 1] * share
    W *= np.clip(1 + 0.05 * _wander(rng, len(t), len(UNITS), fps, 0.2), 0.8, 1.2)
    W = _with_blinks(np.clip(W, 0, 1), rng, fps, MANNERS[actor].blinks)
    slow = _wander(rng, len(t), 6, fps, 0.8)
    head, sway = slow[:, :3] * (9.0, 6.0, 4.0), slow[:, 3:] * (8.0, 4.0, 8.0)
    ends = _envelope(len(t), fps, 0.5, 0.5)[:, None]
    text = "range of motion"
    return _performance(actor, "rom", text, W, ends * head, ends * sway, fps)
