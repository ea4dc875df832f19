"""The four actors registered: every take as motion of the same 397 vertices.

The first call registers all takes of an actor and keeps the result; dense frames are made on
demand. Tena et al. 2011, section 4.1.
"""

from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from tqdm.auto import tqdm

from facelab.checks import check_number
from facelab.data.actors import load_capture, load_template
from facelab.geometry.alignment import Alignment, procrustes
from facelab.geometry.mesh import TriangleMesh
from facelab.keeping import keep_arrays, source_stamp
from facelab.motion import MotionSequence
from facelab.numeric.threads import side_by_side
from facelab.registration.fit import MarkerFit, fit_markers
from facelab.registration.rest import rest_markers
from facelab.registration.sequence import register_sequence
from facelab.registration.warp import PRESETS

N_SAMPLES = 397
"""Vertices of the face that models are trained on, as in the paper."""

_SPACING = 11.0  # mm between markers
_PRESET = "balanced"


@dataclass(frozen=True, eq=False)
class RegisteredActor:
    """One actor's takes in full correspondence.

    Parameters
    ----------
    capture : data_synth.capture.Capture
        What was recorded, and the truth behind it.
    fit : MarkerFit
        The template fitted to the actor's neutral.
    samples : ndarray of int, shape (397,)
        Vertices of the template, the same for every actor.
    mesh : TriangleMesh
        Those, with triangles of their own, in the actor's neutral.
    fps : float
        Frames a second that were kept.
    """

    capture: object
    fit: MarkerFit
    samples: np.ndarray = field(repr=False)
    mesh: TriangleMesh = field(repr=False)
    fps: float
    _frames: dict = field(repr=False)  # take -> frames of the capture, those that were registered
    _positions: dict = field(repr=False)  # take -> (n, 397, 3)

    @property
    def name(self):
        """M1, F1, M2 or F2."""
        return self.capture.actor

    @property
    def takes(self):
        """Names of the takes by kind: dict with train, test, rom and facs."""
        return self.capture.takes

    def names(self, takes=None):
        """Takes by kind, by name, or all for None: tuple of str.

        Raises
        ------
        ValueError
            For a kind or a name that the actor does not have.
        """
        if takes is None:
            return tuple(self.capture.texts)
        if isinstance(takes, str):
            takes = self.takes.get(takes, (takes,))
        unknown = [t for t in takes if t not in self.capture.texts]
        if unknown or not takes:
            kinds = ", ".join(kind for kind, some in self.takes.items() if some)
            raise ValueError(
                f"takes names {', '.join(map(repr, unknown)) or 'nothing'}, but {self.name} has "
                f"the kinds {kinds} and the takes {', '.join(list(self.capture.texts)[:6])}, ..."
            )
        return tuple(takes)

    def motion(self, takes=None):
        """Registered motion of the samples, take after take, without the frames that were lost.

        Parameters
        ----------
        takes : str or sequence of str, optional
            A kind ("train", "test", "rom", "facs"), a name, or names; all if left out.

        Returns
        -------
        MotionSequence
        """
        found = np.concatenate([self._positions[t] for t in self.names(takes)])
        return MotionSequence(found, self.fps, self.mesh)

    def truth(self, takes=None):
        """The skin itself in the frames of `motion`, without noise: MotionSequence.

        In the frame of the fitted neutral, the true neutrals brought to it as a whole.
        """
        link = self.link
        some = [
            self.capture.surface(t, self._frames[t], self.samples) @ link.rotation.T
            for t in self.names(takes)
        ]
        mesh = self.mesh.with_vertices(link.apply(self.capture.neutral.vertices[self.samples]))
        positions = (np.concatenate(some) + link.translation).astype(np.float32)
        return MotionSequence(positions, self.fps, mesh)

    @cached_property
    def link(self):
        """From the frame of the true face to that of the fitted one: Alignment."""
        return procrustes(self.capture.neutral.vertices, self.fit.mesh.vertices)

    def registration(self, take, **options):
        """A take registered anew, at its full rate, for dense frames, faults and confidence.

        Parameters
        ----------
        take : str
        **options
            See `register_sequence`.

        Returns
        -------
        Registration
        """
        (take,) = self.names([take])
        return register_sequence(self.fit, self.capture.markers(take), **options)

    def errors(self, registration, take, frames=None):
        """Distance of registered motion from that of the skin itself, neutrals subtracted.

        Parameters
        ----------
        registration : Registration
            Of the take, with whatever options or gaps.
        take : str
        frames : slice or array_like of int, optional
            All if left out.

        Returns
        -------
        ndarray of shape (n_frames, n_vertices)
            Millimetres; NaN in lost frames.
        """
        found = registration.positions(frames) - self.fit.mesh.vertices
        true = self.capture.surface(take, frames) - self.capture.neutral.vertices
        return np.linalg.norm(found - true @ self.link.rotation.T, axis=2)

    @cached_property
    def covered(self):
        """Skin within 11 mm of a marker, as they are glued: bool, shape (n_vertices,)."""
        feet = np.unique(self.fit.mesh.faces[self.fit.faces])
        return self.fit.mesh.geodesics(feet).min(axis=0) < _SPACING


@lru_cache(maxsize=4)
def _samples(n_vertices):
    """The samples of the template, and their mesh."""
    return load_template(n_vertices).subsample(N_SAMPLES)


def load_registered(actor, size="default", random_state=0, fps=15.0, progress=True):
    """The takes of a synthetic actor in full correspondence, made on first use and kept.

    Parameters
    ----------
    actor : str
        One of `facelab.data.actors.ACTORS`.
    size : {"default", "small"}
        See `load_capture`.
    random_state : int, default=0
        Of the capture.
    fps : float, default=15
        Frames a second to keep, as in Tena et al., section 4.2; a whole fraction of the capture's.
    progress : bool, default=True
        Show progress bars while it is made.

    Returns
    -------
    RegisteredActor

    Raises
    ------
    ValueError
        As `load_capture`, and if `fps` does not divide the rate of the capture.

    Examples
    --------
    >>> import facelab
    >>> facelab.load_registered("M1", size="small", progress=False).motion("train").mesh.n_vertices
    397
    """
    capture = load_capture(actor, size, random_state, progress=progress)
    fps = check_number(fps, "fps", above=0)
    step = round(capture.fps / fps)
    if not step or abs(capture.fps / step - fps) > 1e-6:
        raise ValueError(
            f"fps={fps:g} does not divide the {capture.fps:g} frames a second of the capture."
        )
    arrays = keep_arrays(
        f"registered/{actor}-{size}-{random_state}-{fps:g}",
        {"capture": capture.seal, "code": source_stamp(__name__)},
        lambda: _register_all(capture, step, progress),
    )
    return _unpacked(capture, fps, arrays)


def _register_all(capture, step, progress):
    template = load_template(capture.neutral.n_vertices)
    samples, _ = _samples(template.n_vertices)
    takes = {name: capture.markers(name) for name in capture.texts}
    fit = fit_markers(template, *rest_markers(list(takes.values())), preset=_PRESET)
    arrays = dict(
        vertices=fit.mesh.vertices,
        rotation=fit.alignment.rotation,
        translation=fit.alignment.translation,
        rms=fit.alignment.rms,
        step_names=np.array(list(fit.steps)),
        steps=np.stack(list(fit.steps.values())),
        landmarks=np.array(fit.landmarks),
        residuals=fit.residuals,
        names=np.array(fit.names),
        rest=fit.rest,
        faces=fit.faces,
        weights=fit.weights,
    )

    def registered(take):
        registration = register_sequence(fit, take, progress=False)
        frames = np.arange(0, take.n_frames, step)
        frames = frames[registration.valid[frames]]
        return frames, registration.positions(frames, samples)

    n_frames = sum(take.n_frames for take in takes.values())
    bar = tqdm(
        total=n_frames, desc=f"registering {capture.actor}", unit="frame", disable=not progress
    )
    with bar, closing(side_by_side(registered, list(takes.values()))) as found:
        for name, (frames, positions) in zip(takes, found, strict=True):
            arrays[f"frames.{name}"], arrays[f"positions.{name}"] = frames, positions
            bar.update(takes[name].n_frames)
    return arrays


def _unpacked(capture, fps, arrays):
    template = load_template(capture.neutral.n_vertices)
    samples, small = _samples(template.n_vertices)
    fit = MarkerFit(
        template.with_vertices(arrays["vertices"]),
        Alignment(arrays["rotation"], arrays["translation"], 1.0, float(arrays["rms"]), False),
        dict(zip(arrays["step_names"].tolist(), arrays["steps"], strict=True)),
        tuple(arrays["landmarks"].tolist()),
        arrays["residuals"],
        PRESETS[_PRESET],
        tuple(arrays["names"].tolist()),
        arrays["rest"],
        arrays["faces"],
        arrays["weights"],
    )
    return RegisteredActor(
        capture,
        fit,
        samples,
        small.with_vertices(fit.mesh.vertices[samples]),
        fps,
        *({t: arrays[f"{what}.{t}"] for t in capture.texts} for what in ("frames", "positions")),
    )
