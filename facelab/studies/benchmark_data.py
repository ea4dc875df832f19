"""What the benchmark of linear face models learns from, and is asked about.

Everything on 397 vertices. Motion of the generic face and of Aura is linear in the shapes of their
rigs, which therefore rebuild it exactly; the actors' skin is not linear in anything.
"""

from dataclasses import dataclass, field

import numpy as np

from facelab import data
from facelab.data.actors import ACTORS
from facelab.data.registered import load_registered
from facelab.expression.translate import translate
from facelab.geometry.mesh import TriangleMesh
from facelab.motion import MotionSequence, WeightSequence
from facelab.rig import BlendshapeRig
from facelab.segmentation.regions import Regions
from facelab.segmentation.segment import segment_face

N_VERTICES = 397
N_REGIONS = 13
"""Regions of every region model, as in the paper."""

NOISE = 0.3
"""Noise added to motion that has none, mm per axis."""

FPS = 15.0
"""Frames a second that are learned from; every `EVERY`-th is asked about."""

EVERY = 8


@dataclass(frozen=True, eq=False)
class Asked:
    """Frames to rebuild.

    Parameters
    ----------
    name : str
    frames : ndarray of shape (n_frames, 3 * n_vertices)
        Noisy, displacements from the neutral, millimetres.
    truth : ndarray of the same shape
        The skin itself.
    """

    name: str
    frames: np.ndarray
    truth: np.ndarray


@dataclass(frozen=True, eq=False)
class Task:
    """One training set, and the takes that models of it are asked about.

    Parameters
    ----------
    data : str
        Name of the data set.
    training : str
        What is learned from.
    rich : bool
        Whether all of the training take is learned from, or its first quarter.
    X : ndarray of shape (n_frames, 3 * n_vertices)
        Noisy training frames, displacements from the neutral, millimetres.
    mesh : TriangleMesh
        The control vertices at rest.
    corner : int
        The vertex nearest to the left corner of the mouth.
    asked : tuple of Asked
    rig : BlendshapeRig, optional
        The shapes that a person made for this face, on the same vertices.
    """

    data: str
    training: str
    rich: bool
    X: np.ndarray
    mesh: TriangleMesh
    corner: int
    asked: tuple = field(repr=False)
    rig: BlendshapeRig | None = None

    def regions(self) -> Regions:
        """Regions of the training frames alone."""
        positions = self.X.reshape(len(self.X), -1, 3) + self.mesh.vertices
        motion = MotionSequence(positions, FPS, self.mesh)
        return segment_face(motion, n_regions=N_REGIONS, random_state=0, progress=False)


def actor_tasks(actors=ACTORS, progress=True):
    """Each synthetic actor's training sentences, asked about the others' test sentences.

    Yields
    ------
    Task
        First all sentences of an actor, then the first quarter of them. Frames are registered
        markers, so what is wrong with them is no white noise.
    """
    found = {name: load_registered(name, progress=progress) for name in actors}
    tests = {
        name: Asked(
            name,
            actor.motion("test").displacements()[::EVERY],
            actor.truth("test").displacements()[::EVERY],
        )
        for name, actor in found.items()
    }
    for name, actor in found.items():
        X = actor.motion("train").displacements()
        rig = actor.capture.rig.linear().on(actor.samples, actor.mesh)
        asked = tuple(test for other, test in tests.items() if other != name)
        corner = _corner(actor.fit.mesh, actor.mesh)
        for rich in (True, False):
            some = X if rich else X[: len(X) // 4]
            yield Task("synthetic actors", name, rich, some, actor.mesh, corner, asked, rig)


def generic_takes():
    """Four performances of the generic face: rig on 397 vertices, corner, weights by name.

    Two recorded takes of one performer, production animation of Aura, and the sentences of M1, the
    last two translated to the face's shapes.

    Raises
    ------
    DataUnavailable
        If the generic face or a take is not at hand.
    """
    face = data.load_ict_facekit()
    takes = {name: data.load_take(name).resampled(FPS) for name in data.TAKES}
    animation = data.load_aura_take().resampled(FPS)
    takes["Aura's animation"] = translate(animation, data.load_aura(), face)
    capture = data.load_capture("M1", progress=False)
    spoken = [capture.truth(name).weights for name in capture.takes["train"]]
    step = max(1, round(spoken[0].fps / FPS))
    weights = np.concatenate([take.weights[::step] for take in spoken])
    spoken = WeightSequence(weights, spoken[0].names, FPS)
    takes["M1's sentences"] = translate(spoken, capture.rig.linear(), face)
    rig = face.on(*face.neutral.subsample(N_VERTICES))
    return rig, _corner(face.neutral, rig.neutral), takes


def generic_tasks():
    """Each take of the generic face, asked about the other three: 12 pairs.

    Yields
    ------
    Task
    """
    rig, corner, takes = generic_takes()
    true = {name: rig.animate(take) for name, take in takes.items()}
    pairs = [(a, b) for a in true for b in true if a != b]
    yield from _pairs("generic face", true, rig, corner, pairs)


def aura_tasks():
    """The first half of Aura's animation, all or a quarter of it, asked about the second half.

    Yields
    ------
    Task
    """
    head = data.load_aura()
    rig = head.on(*head.neutral.subsample(N_VERTICES))
    take = data.load_aura_take().resampled(FPS)
    half = take.n_frames // 2
    true = {
        name: rig.animate(WeightSequence(take.weights[some], take.names, FPS))
        for name, some in {
            "first half": slice(0, half),
            "second half": slice(half, None),
        }.items()
    }
    pairs = [("first half", "second half")]
    corner = _corner(head.neutral, rig.neutral)
    yield from _pairs("Aura", true, rig, corner, pairs)
    yield from _pairs("Aura", true, rig, corner, pairs, rich=False)


def _corner(dense, control):
    """The control vertex nearest to the left corner of the mouth."""
    place = dense.vertices[dense.landmarks["mouth_corner_left"]]
    return int(np.linalg.norm(control.vertices - place, axis=1).argmin())


def _pairs(name, true, rig, corner, pairs, rich=True):
    """Tasks from motion without noise: dict of MotionSequence by take."""
    seen = {
        take: [motion.with_noise(NOISE, 2 * i + test).displacements() for test in (0, 1)]
        for i, (take, motion) in enumerate(true.items())
    }
    for training in dict.fromkeys(a for a, _ in pairs):
        asked = tuple(
            Asked(b, seen[b][1][::EVERY], true[b].displacements()[::EVERY])
            for a, b in pairs
            if a == training
        )
        X = seen[training][0]
        some = X if rich else X[: len(X) // 4]
        yield Task(name, training, rich, some, rig.neutral, corner, asked, rig)
