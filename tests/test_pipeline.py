"""One call from takes to a face that can be posed, against the same way gone by hand."""

import numpy as np
import pytest
from shapes import grid_mesh

import facelab
from facelab.geometry import TriangleMesh
from facelab.motion import MarkerSequence, MotionSequence, WeightSequence
from facelab.registration import rest_markers
from facelab.rig import BlendshapeRig


@pytest.fixture(scope="module")
def rig():
    """Eight bumps on a curved patch of 380 vertices, two in each quarter of it."""
    flat = grid_mesh(20, 19, 6.0)
    V = flat.vertices - flat.vertices.mean(axis=0)
    V[:, 2] = -(V[:, 0] ** 2 + V[:, 1] ** 2) / 150
    mesh = TriangleMesh(V, flat.faces, {"mouth_corner_left": 45})
    centres = V[[65, 68, 70, 75, 264, 268, 270, 276]]
    near = np.exp(-((np.linalg.norm(V - centres[:, None], axis=2) / 18) ** 2))
    ways = np.random.default_rng(1).normal(scale=4, size=(8, 1, 3))
    return BlendshapeRig(mesh, [f"unit {i}" for i in range(8)], near[..., None] * ways)


@pytest.fixture
def weights(rig, rng):
    """Two takes, the second with three lost frames."""
    valid = np.arange(90) % 40 != 7
    first, second = rng.uniform(0, 1, size=(2, 90, 8))
    return [
        WeightSequence(first, rig.names, 30),
        WeightSequence(second, rig.names, 30, valid),
    ]


def by_hand(neutral, samples, control, motions, dense, **cut):
    """Regions, model and binding, step by step as in notebook 05."""
    X = np.concatenate([m.displacements() for m in motions])
    slow = [m.resampled(15) for m in motions]
    joined = MotionSequence(
        np.concatenate([m.positions for m in slow]),
        15,
        control,
        np.concatenate([m.valid for m in slow]),
    )
    regions = facelab.segment_face(joined, random_state=0, progress=False, **cut)
    model = facelab.RegionModel(regions, n_components=4).fit(X)
    return model, facelab.bind_to_samples(neutral, samples, motion=dense)


def check_same_pose(face, model, binding):
    """A session of the face answers a drag as one made by hand."""
    posed = []
    for session in (face.session(), facelab.PosingSession(model, face.neutral, binding=binding)):
        vertex = face.neutral.landmarks["mouth_corner_left"]
        session.drag(vertex, face.neutral.vertices[vertex] + [1, 2, -1])
        session.release()
        posed.append(session.vertices)
    np.testing.assert_allclose(*posed, atol=1e-8)
    assert np.linalg.norm(posed[0] - face.neutral.vertices, axis=1).max() > 0.5


def test_takes_of_a_rig_become_the_face_that_the_steps_by_hand_make(rig, weights):
    face = facelab.model_from_take(
        weights, rig, 4, n_control=100, noise=0.1, n_regions=4, progress=False
    )
    samples, control = rig.neutral.subsample(100)
    rng = np.random.default_rng(0)
    motions = [rig.on(samples, control).animate(w).with_noise(0.1, rng) for w in weights]
    dense = [rig.animate(w) for w in weights]
    dense = MotionSequence(np.concatenate([m.positions[m.valid] for m in dense]), 30, rig.neutral)
    model, binding = by_hand(rig.neutral, samples, control, motions, dense, n_regions=4)
    np.testing.assert_array_equal(face.samples, samples)
    np.testing.assert_array_equal(face.regions.labels, model.regions.labels)
    check_same_pose(face, model, binding)


def test_a_motion_of_the_same_frames_becomes_the_same_face(rig, weights):
    settings = dict(n_components=4, n_control=100, n_regions=4, progress=False)
    driven = facelab.model_from_take(weights, rig, **settings)
    moved = facelab.model_from_take([rig.animate(w) for w in weights], **settings)
    check_same_pose(driven, moved.model, moved.binding)


def test_a_face_of_few_vertices_is_its_own_control_mesh(rig, weights):
    face = facelab.model_from_take(weights[0], rig, 4, n_regions=4, progress=False)
    assert face.control is face.neutral and face.binding is None
    assert face.session().vertices.shape == rig.neutral.vertices.shape
    assert "follow" not in face.report


def test_the_report_says_what_was_lost_and_how_exact_the_rest_is(rig, weights):
    face = facelab.model_from_take(weights, rig, 2, n_control=100, n_regions=4, progress=False)
    X = face.motion.displacements()
    off = facelab.rms_error(X, face.model.reconstruct(X))
    assert f"{len(X)} frames" in face.report and "3 lost frames left out" in face.report
    assert f"off by {off:.2f} mm" in face.report and off > 0.05
    assert "4. n_regions=4 was asked for" in face.report
    frames = rig.animate(weights[0]).displacements().reshape(90, -1, 3)
    carried = np.stack([face.binding.carry(x[face.samples]) for x in frames])
    assert face.binding_error == pytest.approx(facelab.rms_error(frames, carried), rel=0.1)


@pytest.fixture(scope="module")
def capture():
    return facelab.data.load_capture("M1", size="small", progress=False)


def test_markers_become_a_face_registered_cut_trained_and_bound(capture):
    template = facelab.load_template(4375)
    takes = [capture.markers(name) for name in capture.takes["train"][:2]]
    face = facelab.model_from_take(takes, template, 4, n_regions=6, progress=False)
    fit = facelab.fit_markers(template, *rest_markers(takes))
    registered = [facelab.register_sequence(fit, take) for take in takes]
    np.testing.assert_allclose(face.neutral.vertices, fit.mesh.vertices, atol=1e-9)
    samples, control = fit.mesh.subsample(397)
    motions = [r.motion(samples, control) for r in registered]
    pairs = [(r, f) for r in registered for f in np.flatnonzero(r.valid)]
    some = np.linspace(0, len(pairs) - 1, min(300, len(pairs))).astype(int)
    dense = np.concatenate([pairs[i][0].positions([pairs[i][1]]) for i in some])
    dense = MotionSequence(dense, takes[0].fps, fit.mesh)
    model, binding = by_hand(fit.mesh, samples, motions[0].mesh, motions, dense, n_regions=6)
    np.testing.assert_array_equal(face.regions.labels, model.regions.labels)
    check_same_pose(face, model, binding)
    assert all(repr(r) in face.report for r in registered)
    assert f"{len(fit.names)} markers met with rms {fit.rms:.2f} mm" in face.report
    again = facelab.model_from_take(takes, fit, 4, n_regions=6, progress=False)
    np.testing.assert_array_equal(again.neutral.vertices, fit.mesh.vertices)


@pytest.mark.parametrize(
    ("takes", "with_face", "error", "message"),
    [
        ("none", False, ValueError, "takes is empty"),
        ("mixed", True, TypeError, "MotionSequence, WeightSequence; give takes of one kind"),
        ("array", False, TypeError, "takes holds ndarray"),
        ("weights", False, TypeError, "face is a NoneType.*BlendshapeRig that they drive"),
        ("motion", True, TypeError, "a motion brings its own mesh"),
        ("markers", True, TypeError, "face is a BlendshapeRig.*template with landmarks"),
        (
            "two meshes",
            False,
            ValueError,
            r"takes\[1\] moves another mesh than takes.0.: their neutrals are up to .* mm apart",
        ),
    ],
)
def test_takes_and_faces_that_do_not_go_together_are_refused(
    rig, weights, takes, with_face, error, message
):
    motion = rig.animate(weights[0])
    wider = MotionSequence(
        motion.positions, 30, rig.neutral.with_vertices(1.1 * rig.neutral.vertices)
    )
    given = {
        "none": [],
        "mixed": [weights[0], motion],
        "array": motion.positions,
        "weights": weights,
        "motion": motion,
        "markers": MarkerSequence(motion.positions[:, :4], "abcd", 30),
        "two meshes": [motion, wider],
    }[takes]
    with pytest.raises(error, match=message):
        facelab.model_from_take(given, rig if with_face else None)


@pytest.mark.parametrize("wrong", [{"noise": -1}, {"fps": 0}, {"n_control": 3}])
def test_settings_out_of_range_are_refused_by_name(rig, weights, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        facelab.model_from_take(weights, rig, **wrong)


def test_takes_of_several_rates_are_said(rig, weights, recwarn):
    fast = WeightSequence(weights[1].weights, rig.names, 60)
    facelab.model_from_take(weights, rig, 2, n_control=100, n_regions=4, progress=False)
    assert not [w for w in recwarn if "frames a second" in str(w.message)]
    with pytest.warns(UserWarning, match=r"takes have 30 and 60 frames a second.*resampled\(30\)"):
        facelab.model_from_take(
            [weights[0], fast], rig, 2, n_control=100, n_regions=4, progress=False
        )
