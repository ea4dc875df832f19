"""The whole way from a captured take to a face that can be posed, in one call.

Notebook 05 goes it step by step; here are the same steps with the settings that serve most faces.
"""

import warnings
from dataclasses import dataclass, field

import numpy as np

from facelab.checks import check_count, check_number, check_type
from facelab.geometry.binding import LinearBinding, bind_to_samples
from facelab.geometry.mesh import TriangleMesh
from facelab.models.evaluation import rms_error
from facelab.models.region import RegionModel
from facelab.motion import MarkerSequence, MotionSequence, WeightSequence
from facelab.numeric.seeds import as_generator
from facelab.posing.session import PosingSession
from facelab.registration.fit import MarkerFit, fit_markers
from facelab.registration.rest import rest_markers
from facelab.registration.sequence import register_sequence
from facelab.rig import BlendshapeRig
from facelab.segmentation.regions import Regions
from facelab.segmentation.segment import segment_face

_BINDING_FRAMES = 300  # dense frames that the binding learns from


@dataclass(frozen=True, eq=False)
class LearnedFace:
    """A face that has learned from takes how it moves, as `model_from_take` makes it.

    Parameters
    ----------
    neutral : TriangleMesh
        The dense face at rest, millimetres.
    control : TriangleMesh
        The few vertices that are solved for; the neutral itself where it has no more.
    samples : ndarray of int, shape (n_control,)
        They, as vertices of the neutral.
    motion : MotionSequence
        What was learned from, on the control mesh, all takes one after the other.
    regions : Regions
        Of the control mesh.
    model : RegionModel
        Of the control mesh.
    binding : LinearBinding or None
        How the dense face follows; None where it is the control mesh.
    binding_error : float
        What the binding leaves of the dense frames that it learned from, RMS, millimetres.
    registrations : tuple of Registration
        Of each take of markers: faults, confidence, and dense frames; empty for other takes.
    """

    neutral: TriangleMesh
    control: TriangleMesh = field(repr=False)
    samples: np.ndarray = field(repr=False)
    motion: MotionSequence
    regions: Regions
    model: RegionModel
    binding: LinearBinding | None = field(repr=False)
    binding_error: float = field(repr=False)
    registrations: tuple = field(repr=False)

    def session(self, **options):
        """A session that poses the dense face by its model: PosingSession.

        Parameters
        ----------
        **options
            As for `PosingSession`: `beta`, `gamma`, `limit` and more.
        """
        return PosingSession(self.model, self.neutral, binding=self.binding, **options)

    @property
    def report(self):
        """What was learned, how exactly, and what was left out: text to print."""
        X = self.motion.displacements()
        lost = self.motion.n_frames - len(X)
        error, size = rms_error(X, self.model.reconstruct(X)), rms_error(X, 0 * X)
        lines = [repr(r) for r in self.registrations]
        if self.registrations:
            fit = self.registrations[0].fit
            lines.insert(0, f"neutral: {len(fit.names)} markers met with rms {fit.rms:.2f} mm")
        lines += [
            f"motion: {len(X)} frames of {size:.2f} mm RMS, {lost} lost frames left out",
            f"regions: {self.regions.n_regions}. {self.regions.why}",
            f"model: {self.model.n_coefficients} coefficients, off by {error:.2f} mm RMS on the "
            "frames that it learned from",
        ]
        if self.binding is not None:
            lines.append(
                f"dense face: {self.neutral.n_vertices} vertices follow {len(self.samples)}, off "
                f"by {self.binding_error:.2f} mm RMS on frames of the takes"
            )
        return "\n".join(lines)


def model_from_take(
    takes,
    face=None,
    n_components=20,
    n_control=397,
    noise=0.0,
    fps=15.0,
    random_state=0,
    progress=True,
    **cut,
):
    """A face that can be posed, from takes of how it moves.

    Markers are registered to a template first. Then the face is cut into regions by how it moves,
    a region model is trained on few vertices, and the dense face is bound to those.

    Parameters
    ----------
    takes : MarkerSequence, MotionSequence or WeightSequence, or a list of one of these kinds
        Of one person in one session; millimetres. Takes of markers begin with the face at rest.
    face : TriangleMesh, MarkerFit or BlendshapeRig, optional
        For markers the template with its landmarks (`load_template()`), or a neutral that is
        fitted already; for weights the rig that they drive. A motion has its own mesh.
    n_components : int or float, default=20
        Modes of each region, or the share of variance that they hold; see `RegionModel`.
    n_control : int, default=397
        Vertices to solve for; all of them if the face has no more.
    noise : float, default=0.0
        Gaussian noise put on the motion as a capture has it, millimetres per axis; 0.3 for
        motion out of a rig, which without any hardly sets the number of regions.
    fps : float, default=15.0
        Frames a second that decide the regions; models learn from all frames.
    random_state : int, default=0
    progress : bool, default=True
        Show progress bars.
    **cut
        For `segment_face`: `lam`, `r`, `threshold` and more; give `n_regions` where the report
        says that growth stopped sooner than a face has parts.

    Returns
    -------
    LearnedFace
        `session()` poses it; `report` says in words how exact all of it is.

    Raises
    ------
    TypeError
        For takes of another or of several kinds, or a face that does not go with them.
    ValueError
        For no takes, motion of several meshes, a face in pieces, and as `fit_markers`,
        `register_sequence`, `segment_face` and `RegionModel.fit`.

    Warns
    -----
    UserWarning
        For takes of several frame rates.

    References
    ----------
    Tena et al. 2011, sections 3 and 4.

    Examples
    --------
    >>> import facelab
    >>> capture = facelab.data.load_capture("M1", size="small", progress=False)
    >>> takes = [capture.markers(name) for name in capture.takes["train"]]
    >>> template = facelab.load_template(4375)
    >>> face = facelab.model_from_take(takes, template, n_regions=8, progress=False)
    >>> session = face.session()
    >>> corner = face.neutral.landmarks["mouth_corner_left"]
    >>> session.drag(corner, face.neutral.vertices[corner] + [4, 6, -2])
    >>> session.vertices.shape
    (4375, 3)
    """
    takes = list(takes) if isinstance(takes, (list, tuple)) else [takes]
    if not takes:
        raise ValueError("takes is empty; give one take or more.")
    kinds = {type(take) for take in takes}
    if len(kinds) > 1 or not kinds <= set(_SOURCES):
        raise TypeError(
            f"takes holds {', '.join(sorted(kind.__name__ for kind in kinds))}; give takes of one "
            "kind: MarkerSequence, MotionSequence or WeightSequence."
        )
    noise = check_number(noise, "noise", low=0)
    fps = check_number(fps, "fps", above=0)
    n_control = check_count(n_control, "n_control", 4, None, "vertices")
    source = _SOURCES[kinds.pop()](takes, face, progress)
    neutral = source.neutral
    if neutral.n_vertices > n_control:
        samples, control = neutral.subsample(n_control)
    else:
        samples, control = np.arange(neutral.n_vertices), neutral
    motions = [source.motion(i, samples, control) for i in range(len(takes))]
    if noise:
        rng = as_generator(random_state)
        motions = [motion.with_noise(noise, rng) for motion in motions]
    rates = sorted({motion.fps for motion in motions})
    if len(rates) > 1:
        warnings.warn(
            f"takes have {' and '.join(f'{rate:g}' for rate in rates)} frames a second: all frames "
            "count alike, so the faster ones count more. Bring them to one rate "
            f"(take.resampled({rates[0]:g})), or leave it so if that is meant.",
            stacklevel=2,
        )
    slow = _joined([motion.resampled(min(fps, motion.fps)) for motion in motions])
    regions = segment_face(slow, random_state=random_state, progress=progress, **cut)
    motion = _joined(motions)
    model = RegionModel(regions, n_components, random_state=random_state)
    model.fit(motion.displacements())
    binding, error = None, 0.0
    if neutral is not control:
        dense = _dense_frames(source, motions)
        binding = bind_to_samples(neutral, samples, motion=dense)
        error = _carry_error(binding, dense)
    registrations = tuple(getattr(source, "registrations", ()))
    return LearnedFace(
        neutral, control, samples, motion, regions, model, binding, error, registrations
    )


class _Markers:
    """Takes of markers, registered to a template."""

    def __init__(self, takes, face, progress):
        what = "takes of markers ask for a template with landmarks (load_template()) or a MarkerFit"
        check_type(face, "face", (TriangleMesh, MarkerFit), what)
        fitted = isinstance(face, MarkerFit)
        fit = face if fitted else fit_markers(face, *rest_markers(takes))
        self.neutral = fit.mesh
        self.registrations = [register_sequence(fit, take, progress=progress) for take in takes]

    def motion(self, i, samples, control):
        return self.registrations[i].motion(samples, control)

    def dense(self, i, frames):
        return self.registrations[i].positions(frames)


class _Motions:
    """Takes of a mesh in motion."""

    def __init__(self, takes, face, _):
        if face is not None:
            raise TypeError(
                f"face is a {type(face).__name__}, but a motion brings its own mesh: leave it out."
            )
        self.takes, self.neutral = takes, takes[0].mesh
        for i, take in enumerate(takes):
            same = np.array_equal(take.mesh.faces, self.neutral.faces)
            if not same or not np.array_equal(take.mesh.vertices, self.neutral.vertices):
                how = f"{take.mesh} and {self.neutral}"
                if same:
                    off = np.linalg.norm(take.mesh.vertices - self.neutral.vertices, axis=1).max()
                    how = f"their neutrals are up to {off:.3g} mm apart"
                raise ValueError(
                    f"takes[{i}] moves another mesh than takes[0]: {how}. Give takes of one face, "
                    "all registered with the same fit (of the command line: --rest)."
                )

    def motion(self, i, samples, control):
        take = self.takes[i]
        return MotionSequence(take.positions[:, samples], take.fps, control, take.valid)

    def dense(self, i, frames):
        return self.takes[i].positions[frames]


class _Weights:
    """Takes of weights that drive a rig."""

    def __init__(self, takes, face, progress):
        what = "takes of weights ask for the BlendshapeRig that they drive"
        self.takes, self.rig = takes, check_type(face, "face", BlendshapeRig, what)
        self.neutral = face.neutral

    def motion(self, i, samples, control):
        return self.rig.on(samples, control).animate(self.takes[i])

    def dense(self, i, frames):
        return self.rig.animate(self.takes[i][frames]).positions


_SOURCES = {MarkerSequence: _Markers, MotionSequence: _Motions, WeightSequence: _Weights}


def _joined(motions):
    """One motion after the other."""
    first = motions[0]
    positions, valid = ([getattr(m, a) for m in motions] for a in ("positions", "valid"))
    return MotionSequence(np.concatenate(positions), first.fps, first.mesh, np.concatenate(valid))


def _dense_frames(source, motions):
    """Some frames of the dense face, spread evenly over all that are valid: MotionSequence."""
    take = np.repeat(np.arange(len(motions)), [m.n_frames for m in motions])
    frame = np.concatenate([np.arange(m.n_frames) for m in motions])
    valid = np.flatnonzero(np.concatenate([m.valid for m in motions]))
    few = min(_BINDING_FRAMES, len(valid))
    some = valid[np.linspace(0, len(valid) - 1, few).astype(int)]
    parts = [source.dense(i, frame[some[take[some] == i]]) for i in np.unique(take[some])]
    return MotionSequence(np.concatenate(parts), motions[0].fps, source.neutral)


def _carry_error(binding, dense):
    """What a binding leaves of dense frames when the control vertices are where they are, mm."""
    shape = len(dense.positions), binding.mesh.n_vertices, 3
    moved = dense.displacements().reshape(shape).transpose(1, 0, 2)
    carried = binding.carry(moved[binding.samples].reshape(len(binding.samples), -1))
    return rms_error(moved, carried.reshape(moved.shape))
