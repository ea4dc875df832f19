"""Heads and scans for the notebooks, each with something in its place."""

import warnings
from dataclasses import dataclass

import numpy as np

from facelab.data import (
    DataUnavailable,
    load_aura,
    load_example,
    load_ict_facekit,
    load_registered,
)
from facelab.geometry import TriangleMesh
from facelab.rig import BlendshapeRig


@dataclass(frozen=True)
class Head:
    """A head to begin with: which one it is, what it is in a sentence, and its rig."""

    name: str
    about: str
    rig: BlendshapeRig


def load_head(name):
    """A head by name: Head; the example's where Aura cannot be had, which `about` says.

    Parameters
    ----------
    name : {"Aura", "example", "F1"}
    """
    if name == "F1":
        from data_synth.action_units import actor_rig

        return Head(name, "SYNTHETIC: actor F1, a face made by code.", actor_rig("F1").linear())
    if name == "Aura":
        try:
            return Head(name, "REAL: Aura, a production head of 72 units.", load_aura())
        except DataUnavailable as missing:
            example = load_example()
            return Head("example", f"{example.about} (Aura: {missing})", example.rig)
    example = load_example()
    return Head(name, example.about, example.rig)


def rms_by_name(pair, take):
    """What is left of a take's motion where only equal names carry it: RMS, mm.

    Parameters
    ----------
    pair : facelab.expression.Translator
    take : WeightSequence
        Of the rig that is translated from.
    """
    with warnings.catch_warnings(action="ignore"):  # that few names agree is what is shown
        theirs, named = (_driven(rig, take) for rig in (pair.rig, pair.other))
    return float(np.sqrt((pair.difference(theirs, named)[take.valid] ** 2).mean()))


def _driven(rig, take):
    """A take's weights by name; zeros for a rig that no name drives."""
    if rig.match(take).driven:
        return rig.rig_weights(take)
    return np.zeros((take.n_frames, len(rig.names)))


@dataclass(frozen=True)
class Scan:
    """A face as a surface with landmarks, and what it is in a sentence."""

    about: str
    mesh: TriangleMesh


def load_scan(template, random_state=1):
    """A person out of ICT-FaceKit's identities, or actor F2 where they cannot be had: Scan.

    Parameters
    ----------
    template : TriangleMesh
        Gives its landmarks to the actor, whose triangles are the same.
    random_state : int
        Which person.
    """
    try:
        rig = load_ict_facekit(area="face", n_identities=20)
    except DataUnavailable as missing:
        skin = load_registered("F2").capture.neutral
        about = f"SYNTHETIC: F2 (no scanned face here: {missing})"
        return Scan(about, TriangleMesh(skin.vertices, skin.faces, template.landmarks))
    modes = np.stack(list(rig.identities.values()))
    some = np.random.default_rng(random_state).normal(size=len(modes))
    mesh = rig.neutral.with_vertices(rig.neutral.vertices + np.tensordot(some, modes, 1))
    return Scan("REAL: an identity of ICT-FaceKit", mesh)
