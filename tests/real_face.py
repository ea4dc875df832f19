"""The scanned face and the recorded takes, made ready once: what tests of models share."""

from functools import cache
from types import SimpleNamespace

import numpy as np

from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.segmentation.segment import segment_face

NOISE = 0.3
"""Noise of a capture, millimetres on each axis."""

PULLED = ("mouth_corner_left", "lip_upper", "lip_lower", "brow_left_3", "brow_right_2", "chin")
LIDS = ("eye_left_upper_inner", "eye_left_upper_outer", "eye_right_upper_inner")


@cache
def control_face(rig, take):
    """397 vertices of the face in the motion of a take, with and without noise, and its regions."""
    face = rig.neutral
    keep = [face.landmarks[name] for name in (*PULLED, *LIDS)]
    samples, mesh = face.subsample(397, keep=keep)
    motion = rig.on(samples, mesh).animate(take.resampled(15))
    rng = np.random.default_rng(4)
    noisy = type(motion)(
        motion.positions + rng.normal(scale=NOISE, size=motion.positions.shape), motion.fps, mesh
    )
    return SimpleNamespace(
        mesh=mesh,
        samples=samples,
        motion=motion,
        X_true=motion.displacements(),
        X=noisy.displacements(),
        regions=segment_face(noisy, random_state=0, progress=False),
    )


def models(face, n_components):
    """Region model and holistic model learned from the noisy frames."""
    return (
        RegionModel(face.regions, n_components).fit(face.X),
        HolisticModel(n_components).fit(face.X),
    )
