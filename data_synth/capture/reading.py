"""A capture, read: the recorded takes of one actor and the truth behind them."""

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from data_synth.action_units import actor_rig
from data_synth.capture.faults import Ghost, Swap
from data_synth.capture.recording import SIZES, VERSION, true_markers
from data_synth.capture.sites import Sites
from data_synth.performance import SENTENCES
from data_synth.units import UNITS
from facelab.checks import check_choice
from facelab.files.markers.c3d import read_c3d
from facelab.keeping import fault, read_manifest, source_stamp
from facelab.motion import MarkerSequence, WeightSequence
from facelab.storage import load_npz


@dataclass(frozen=True, eq=False)
class Truth:
    """What lies behind the markers of one take.

    Parameters
    ----------
    weights : WeightSequence
        Of the forty action units.
    rotation : ndarray of shape (n_frames, 3, 3)
    translation : ndarray of shape (n_frames, 3)
        Head pose: a point x of the head frame is seen at rotation @ x + translation,
        millimetres.
    sites : Sites
    noise : ndarray of shape (3,)
        Standard deviation on each axis of the capture frame, millimetres.
    swaps : tuple of Swap
    ghosts : tuple of Ghost
    random_state : int
        The seed that all of it follows from.
    """

    weights: WeightSequence
    rotation: np.ndarray = field(repr=False)
    translation: np.ndarray = field(repr=False)
    sites: Sites = field(repr=False)
    noise: np.ndarray
    swaps: tuple
    ghosts: tuple
    random_state: int


class Capture:
    """The recorded takes of one actor, and the truth behind them.

    Parameters
    ----------
    folder : str or Path
        Made by `make_capture` or `open_capture`.
    rig : ActionUnitRig, optional
        The actor's face, or another with its `names`, `neutral` and `animate`; built when first
        needed if left out.
    check : bool, default=True
        Whether to hold the files against their checksums.

    Raises
    ------
    ValueError
        If the folder is incomplete or damaged.

    Attributes
    ----------
    actor, size, random_state : str, str, int
    seal : str
        Fingerprint of all its files and of what they follow from.
    fps : float
        Frames a second.
    takes : dict of str to tuple of str
        Names of the takes by kind: `train` and `test` sentences, `rom`, `facs`.
    texts : dict of str to str
        What is said or shown in each take.
    """

    def __init__(self, folder, rig=None, check=True):
        self.folder = Path(folder)
        wrong = fault(self.folder, {"version": VERSION}) if check else None
        if wrong is not None:
            raise ValueError(f"folder={str(folder)!r} holds no whole capture: {wrong}.")
        manifest = read_manifest(self.folder)
        self.seal, self._code = manifest["seal"], manifest["key"]["code"]
        self.actor, self.size, self.random_state = (
            manifest["key"][name] for name in ("actor", "size", "random_state")
        )
        about = json.loads((self.folder / "takes.json").read_text())
        self._n_markers, self._about = about["n_markers"], about["takes"]
        self.fps = next(iter(self._about.values()))["fps"]
        self.texts = {name: about["text"] for name, about in self._about.items()}
        self.takes = {"train": (), "test": (), "rom": (), "facs": ()}
        for name in self.texts:
            kind = SENTENCES[name].split if name in SENTENCES else name.split("_")[0]
            self.takes[kind] += (name,)
        self._given_rig = rig

    def __repr__(self):
        counts = ", ".join(f"{len(names)} {kind}" for kind, names in self.takes.items() if names)
        frames = sum(about["n_frames"] for about in self._about.values())
        return (
            f"Capture({self.actor}: {self._n_markers} markers, {counts} takes, "
            f"{frames} frames; random_state={self.random_state})"
        )

    @cached_property
    def rig(self):
        """The actor's face with its forty action units.

        Raises
        ------
        ValueError
            If the code that makes the faces has changed since the capture: the skin would not
            be the one that wore the markers.
        """
        if self._given_rig is not None:
            return self._given_rig
        if self._code != source_stamp(__package__):
            raise ValueError(
                f"{self.folder} was made by another version of data_synth, whose faces cannot be "
                "rebuilt by this one; make the capture again."
            )
        return actor_rig(self.actor, SIZES[self.size].n_vertices)

    @property
    def neutral(self):
        """The actor's face at rest: TriangleMesh, head frame."""
        return self.rig.neutral

    @cached_property
    def _stored(self):
        return load_npz(self.folder / "truth.npz", "data_synth-truth", 1)

    @cached_property
    def sites(self):
        """Where the markers are glued: Sites."""
        s = self._stored
        return Sites(tuple(s["site_names"].tolist()), s["site_faces"], s["site_weights"])

    def path(self, take):
        """The C3D file of a take, for other tools."""
        check_choice(take, "take", tuple(self.texts))
        return self.folder / f"{take}.c3d"

    def markers(self, take):
        """What the capture system delivers of a take.

        Parameters
        ----------
        take : str
            One of those in `takes`.

        Returns
        -------
        MarkerSequence
            Millimetres, capture frame; noisy, with gaps, swaps and ghosts.

        Raises
        ------
        ValueError
            For an unknown take; the message lists those there are.
        """
        return read_c3d(self.path(take))

    def truth(self, take):
        """What lies behind the markers of a take: Truth."""
        check_choice(take, "take", tuple(self.texts))
        about, s = self._about[take], self._stored
        angles = {a: s[f"{take}.{a}"] for a in ("HeadYaw", "HeadPitch", "HeadRoll")}
        return Truth(
            WeightSequence(s[f"{take}.weights"].astype(float), UNITS, about["fps"], angles=angles),
            s[f"{take}.rotation"],
            s[f"{take}.translation"],
            self.sites,
            s["noise"],
            tuple(Swap(*swap) for swap in about["swaps"]),
            tuple(Ghost(*ghost) for ghost in about["ghosts"]),
            self.random_state,
        )

    def true_markers(self, take):
        """The markers of a take without noise, gaps, swaps and ghosts: MarkerSequence."""
        truth = self.truth(take)
        centres, _ = true_markers(
            self.rig, self.sites, truth.weights.weights, truth.rotation, truth.translation
        )
        return MarkerSequence(centres, self.sites.names, truth.weights.fps)

    def surface(self, take, frames=None, vertices=None):
        """The skin itself in some frames of a take, rebuilt from the weights.

        Parameters
        ----------
        take : str
        frames : slice or array_like of int, optional
            All of them if left out.
        vertices : array_like of int, optional
            Vertices of `neutral`; all of them if left out.

        Returns
        -------
        positions : ndarray of float32, shape (n_frames, n_vertices, 3)
            Millimetres, head frame: the head's motion is not in them.

        Raises
        ------
        ValueError
            For an unknown take, frames or vertices that do not exist, or more than 2 GiB.
        """
        weights = self.truth(take).weights.weights
        weights = weights[_picked(frames, len(weights), "frames")]
        n = self.neutral.n_vertices
        vertices = np.arange(n)[_picked(vertices, n, "vertices")]
        n = len(vertices)
        if len(weights) * n * 12 > 2**31:
            gigabytes = len(weights) * n * 12 / 2**30
            raise ValueError(
                f"{len(weights)} frames of {n} vertices are {gigabytes:.1f} GiB; ask for fewer "
                "frames or vertices at a time."
            )
        positions = np.empty((len(weights), n, 3), dtype=np.float32)
        for first in range(0, len(weights), 64):
            part = slice(first, first + 64)
            positions[part] = self.rig.animate(weights[part], vertices=vertices)
        return positions


def _picked(index, size, name):
    """A slice as it is, all for None, or indices that are sure to exist."""
    if index is None or isinstance(index, slice):
        return index or slice(None)
    index = np.atleast_1d(index)
    if index.dtype.kind not in "iu" or index.ndim != 1:
        raise TypeError(f"{name} must be a slice or a list of integers.")
    bad = index[(index < 0) | (index >= size)]
    if bad.size:
        raise ValueError(f"{name} holds {bad[0]}, but there are {size}: 0 to {size - 1}.")
    return index
