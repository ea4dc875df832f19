"""Speech: what the mouth aims at for each sound, and how neighbours colour each other."""

import numpy as np

from data_synth.performance.tracks import unit_weights

# Unit weights, seconds, and how firmly a sound holds against its neighbours.
# AU25 parts the lips, AU26 and AU27 drop the jaw.
_AIMS = {
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
VISEMES = {
    phone: (unit_weights(units), seconds, firm)
    for phones, (units, seconds, firm) in _AIMS.items()
    for phone in phones.split()
}
"""Weights of the units (40,), seconds and firmness by phone."""
DIPHTHONGS = {
    "AY": ("AA", "IH"), "AW": ("AA", "UH"), "OY": ("AO", "IH"), "EY": ("EH", "IY"),
    "OW": ("AO", "UW"),
}  # fmt: skip


def sounds(sentence, manner, rng):
    """Visemes of a sentence in time: middle (s), length (s), target (S, 40), firmness, stress."""
    lengths, targets, firm, stress = [], [], [], []
    for phone in sentence.phones:
        stressed = phone.endswith("1")
        sound = phone.rstrip("1")
        parts = DIPHTHONGS.get(sound, (sound,))
        for part in parts:
            target, seconds, hold = VISEMES[part]
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
