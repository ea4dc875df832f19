"""How well weights go from one rig to another and back: the translator and its peers in one table.

import facelab
from facelab.studies import translation
aura, face = facelab.data.load_aura(), facelab.load_ict_facekit()
pair = translation.both_ways(aura, face)
print(translation.table(*pair, facelab.data.load_aura_take(), translation.AURA_BY_NAME))
"""

import time
from dataclasses import dataclass

import numpy as np

from facelab.expression.transfer import UnitCarrier
from facelab.expression.translate import Translator
from facelab.motion import WeightSequence
from facelab.numeric.least_squares import solve_bounded_rows
from facelab.numeric.threads import one_thread
from facelab.rig import BlendshapeRig


def _both(**names):
    return {f"{a}_{s}": (f"{b}_{s}",) for a, b in names.items() for s in "LR"}


AURA_BY_NAME = {
    **_both(browDown="browDown", cheekPuff="cheekPuff", cheekRaiser="cheekSquint"),
    **_both(dimpler="mouthDimple", eyesClosed="eyeBlink", eyesLookDown="eyeLookDown"),
    **_both(eyesLookUp="eyeLookUp", innerBrowRaiser="browInnerUp", lidTightener="eyeSquint"),
    **_both(lipCornerDepressor="mouthFrown", lipCornerPuller="mouthSmile"),
    **_both(lipPressor="mouthPress", lipStretcher="mouthStretch", noseWrinkler="noseSneer"),
    **_both(mouthLowerDown="mouthLowerDown", outerBrowRaiser="browOuterUp"),
    **_both(upperLidRaiser="eyeWide", upperLipRaiser="mouthUpperUp"),
    **{"eyesLookLeft_L": ("eyeLookOut_L",), "eyesLookLeft_R": ("eyeLookIn_R",)},
    **{"eyesLookRight_L": ("eyeLookIn_L",), "eyesLookRight_R": ("eyeLookOut_R",)},
    **{"jawDrop": ("jawOpen",), "jawThrust": ("jawForward",)},
    **{"jawSidewaysLeft": ("jawLeft",), "jawSidewaysRight": ("jawRight",)},
    **{"mouthLeft": ("mouthLeft",), "mouthRight": ("mouthRight",)},
    **{"chinRaiser_B": ("mouthShrugLower",), "chinRaiser_T": ("mouthShrugUpper",)},
    **{f"lipPucker_{s}": ("mouthPucker",) for s in "LR"},
    **{f"lipFunneler_{q}": ("mouthFunnel",) for q in ("LB", "LT", "RB", "RT")},
    **{f"lipSuck_{s}B": ("mouthRollLower",) for s in "LR"},
    **{f"lipSuck_{s}T": ("mouthRollUpper",) for s in "LR"},
}
"""The shapes of ICT-FaceKit that a person would name for each unit of Aura."""


@dataclass(frozen=True)
class Trip:
    """A take translated there, and back again.

    Parameters
    ----------
    way : str
        How it was translated.
    moves, left : float
        Motion of the take, and what the translated take leaves of it, RMS over frames and the
        face, millimetres.
    lost : float
        Share of the motion that is lost there and back.
    off : float
        Mean error of the weights there and back, as a share of their mean; 1 for a face at rest.
    active : float
        Shapes at more than 0.01 in a translated frame, on average.
    per_second : float
        Frames translated in a second of one processor.
    """

    way: str
    moves: float
    left: float
    lost: float
    off: float
    active: float
    per_second: float

    def __str__(self):
        return (
            f"{self.way:<12}{self.moves:7.2f}{self.left:7.2f}{100 * self.lost:8.1f} %"
            f"{self.off:7.2f}{self.active:8.1f}{self.per_second:9.0f}"
        )


HEAD = f"{'way':<12}{'moves':>7}{'left':>7}{'lost':>10}{'off':>7}{'active':>8}{'frames/s':>9}"
"""Heads of the columns of a printed `Trip`."""


def both_ways(rig, other):
    """Translators of two rigs, there and back."""
    return Translator(rig, other), Translator(other, rig)


def by_names(take, rig, other, table):
    """A take of `rig` as one of `other` by a table of names: the largest of those meant.

    Parameters
    ----------
    take : WeightSequence
    rig, other : BlendshapeRig
    table : dict of str to tuple of str
        Shapes of `other` for each shape of `rig`.

    Returns
    -------
    WeightSequence
    """
    weights = rig.rig_weights(take)
    to = np.zeros((len(weights), len(other.names)))
    for name, w in zip(rig.names, weights.T, strict=True):
        for found in table.get(name, ()):
            k = other.names.index(found)
            to[:, k] = np.maximum(to[:, k], w)
    return WeightSequence(to, other.names, take.fps, take.valid)


def turned(table):
    """A table of names for the way back."""
    back = {}
    for name, found in table.items():
        for other in found:
            back[other] = (*back.get(other, ()), name)
    return back


class FrameTransfer:
    """Translation by deformation transfer (Sumner and Popovic 2004), a peer.

    Each frame is carried to the other face itself, and read there by the nearest shapes of the
    other rig within 0 and 1. Both faces are those of a translator: the template's own, and the
    template as it was fitted to the other rig.

    Parameters
    ----------
    pair : Translator
    """

    def __init__(self, pair):
        space, guest = pair.space, pair.rig if pair.turned else pair.other
        rest = guest.neutral.vertices
        home = space.to_template(rest)
        there = np.stack([space.to_template(rest + d) - home for d in guest.deltas])
        rigs = space.source, BlendshapeRig(space.rig.neutral, guest.names, there)
        self.names, self._driven = pair.other.names, pair.rig
        self._source, target = reversed(rigs) if pair.turned else rigs
        self._carrier = UnitCarrier(self._source.neutral, target.neutral)
        self._both = space.covered
        self._shapes = target.basis[:, self._both].reshape(len(self.names), -1)

    def translate(self, take):
        """A take of the translator's `rig` as one of its `other`, WeightSequence."""
        D = self._shapes
        H = D @ D.T
        H += 1e-5 * np.diagonal(H).mean() * np.eye(len(H))  # as the translator's
        G = np.zeros((take.n_frames, len(D)))
        weights = self._driven.rig_weights(take)
        for t in np.flatnonzero(take.valid):
            moved = self._carrier.carry(self._source.displacements(weights[t]))[0]
            G[t] = D @ moved[self._both].ravel()
        W = np.full_like(G, np.nan)
        lo, hi = np.zeros(len(D)), np.ones(len(D))
        W[take.valid] = solve_bounded_rows(H, G[take.valid], lo, hi)
        return WeightSequence(W, self.names, take.fps, take.valid)


def _translator(pair, way, table):
    """What translates takes of `pair.rig` in one way: callable of a take."""
    if way == "names":
        return lambda take: by_names(take, pair.rig, pair.other, table)
    if way == "transfer":
        return FrameTransfer(pair).translate
    how = {"map": {}, "nearest": dict(lam=0, smooth=0, near=1)}[way]
    return lambda take: pair.translate(take, **how)


def trip(there, back, take, way="map", table=None):
    """One take there and back in one way.

    Parameters
    ----------
    there, back : Translator
        As `both_ways` gives them.
    take : WeightSequence
        Of `there.rig`.
    way : {"map", "nearest", "transfer", "names"}
        The translator as it is; plain nearest shapes (near=1, nothing sparse or smooth);
        deformation transfer, see `FrameTransfer`; a table of names.
    table : dict, optional
        For "names", see `by_names`.

    Returns
    -------
    Trip
    """
    forth = _translator(there, way, table)
    home = _translator(back, way, table and turned(table))
    with one_thread():
        forth(take[np.flatnonzero(take.valid)[:1]])  # what is prepared once for a pair
        start = time.process_time()
        to = forth(take)
        seconds = time.process_time() - start
        again = home(to)
    w, b, w2 = there.rig.rig_weights(take), to.weights, again.weights
    w, b, w2 = w[take.valid], b[take.valid], w2[take.valid]
    rest = np.zeros_like(b)
    moves = _rms(there.difference(w, rest))
    return Trip(
        way,
        moves,
        _rms(there.difference(w, b)),
        _rms(there.motion(w2 - w)) / moves,
        float(np.abs(w2 - w).mean() / w.mean()),
        float((b > 0.01).sum(axis=1).mean()),
        take.n_frames / max(seconds, 1e-6),
    )


def table(there, back, take, names=None):
    """Text with a line for each way of translating a take there and back."""
    ways = [("nearest", None), ("map", None)] + ([("names", names)] if names else [])
    return "\n".join([HEAD, *(str(trip(there, back, take, way, t)) for way, t in ways)])


def _rms(mm):
    return float(np.sqrt((mm**2).mean()))
