"""One interface for every model, and a fifth model that is added here alone."""

import ast
import itertools
from pathlib import Path

import numpy as np
import pygltflib
import pytest
from planted import bumpy_rig, corner_regions, waves
from sklearn.exceptions import NotFittedError

import facelab
from facelab.face_model import FaceModel
from facelab.files.gltf import write_clip_glb
from facelab.files.poses import load_clip, load_pose, read_log, save_clip, save_pose
from facelab.models.global_local import GlobalLocalModel
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.motion import WeightSequence
from facelab.posing.clips import Clip
from facelab.posing.log import replay
from facelab.posing.session import PosingSession
from facelab.posing.solver import PoseSolver
from facelab.rig import BlendshapeRig


class AveragedFrames(FaceModel):
    """A fifth model: its basis is what frames are like on average, stretch after stretch."""

    def __init__(self, X, n_stretches=6):
        stretches = np.array_split(X, n_stretches)
        self._basis = np.array([part.mean(axis=0) for part in stretches]).reshape(
            len(stretches), -1, 3
        )

    @property
    def basis(self):
        return self._basis


class Bounded(AveragedFrames):
    """The same, its coefficients kept from 0 to 2 and called by names of their own."""

    bounds = (0.0, 2.0)
    named = True

    def component_names(self, region):
        return [f"stretch {k}" for k in range(self.n_coefficients)]


def mesh():
    return corner_regions().mesh


def frames():
    regions = corner_regions()
    return waves(regions.mesh, regions.labels, np.random.default_rng(5))


def rig():
    rng = np.random.default_rng(7)
    return BlendshapeRig(mesh(), "abcde", rng.normal(size=(5, mesh().n_vertices, 3)))


def turned():
    """A region model whose modes are turned and stretched."""
    model, rng = RegionModel(corner_regions(), 4).fit(frames()), np.random.default_rng(8)
    bases = [rng.normal(size=(len(B), len(B))) @ B for B in model.components_]
    return RegionModel.from_bases(model.regions, model.mean_, bases, blending="gradient")


MODELS = {
    "region": lambda: RegionModel(corner_regions(), 4).fit(frames()),
    "holistic": lambda: HolisticModel(6).fit(frames()),
    "between": lambda: GlobalLocalModel(corner_regions(), 6).fit(frames()),
    "turned": turned,
    "cut": lambda: RegionModel.from_bases(corner_regions(), np.zeros(126), rig().deltas),
    "rig": rig,
    "averaged": lambda: AveragedFrames(frames()),
    "bounded": lambda: Bounded(frames()),
}


@pytest.fixture(params=MODELS)
def model(request):
    return MODELS[request.param]()


def pull(session, vertex, by):
    session.drag(vertex, session.vertices[vertex] + by)
    session.release()


# --- the interface --------------------------------------------------------------------------------


def test_what_a_model_says_of_itself_fits_together(model, rng):
    P, N = model.n_coefficients, model.n_vertices
    assert model.basis.shape == (P, N, 3) and N == 42
    c = rng.uniform(0, 1, size=(3, P))
    np.testing.assert_allclose(
        model.displacements(c), np.tensordot(c, model.basis, axes=1), atol=1e-10
    )
    assert (model.displacements(np.zeros(P)) == 0).all(), "zero is exactly the neutral"
    slices = model.slices
    assert np.concatenate([np.arange(P)[s] for s in slices]).tolist() == list(range(P))
    for region, s in enumerate(slices):
        names = model.component_names(region)
        assert len(set(names)) == s.stop - s.start
    for v in (0, 17, 41):
        np.testing.assert_allclose(model.vertex_rows(v), model.basis[:, v].T, atol=1e-10)
        assert len(model.copy_rows(v)) == model.holders[v]
    if model.mesh is not None:
        assert model.mesh.n_vertices == N
    assert model.check_fitted() is model


def test_what_equation_9_asks_of_a_model_is_never_negative(model, rng):
    P = model.n_coefficients
    for boundary in (model.boundary(), model.boundary([20, 21])):
        assert boundary.shape == (P, P)
        np.testing.assert_allclose(boundary, boundary.T, atol=1e-12)
        assert np.linalg.eigvalsh(boundary).min() > -1e-9
    W = model.resistance(rng.uniform(0.5, 2, model.n_vertices))
    assert np.linalg.eigvalsh(W).min() > 0
    assert model.gaps(rng.normal(size=P)).min() >= 0


def test_coefficients_are_found_again_from_the_face_they_make(model, rng):
    if model.regions is not None:
        pytest.skip("blended regions that disagree do not come apart again")
    c = rng.uniform(0.1, 0.9, size=(4, model.n_coefficients))
    np.testing.assert_allclose(model.encode(model.displacements(c)), c, atol=1e-6)


def test_coefficients_of_regions_are_counted_from_the_neutral(rng):
    model = turned()
    X = rng.normal(size=(4, 42, 3))
    at_rest = model.transform(np.zeros((1, 126)))
    expected = model.transform(X.reshape(4, -1)) - at_rest
    np.testing.assert_allclose(model.encode(X), expected, atol=1e-10)
    learned = MODELS["region"]()
    mean, deviations = learned.training()
    np.testing.assert_allclose(mean, -learned.transform(np.zeros((1, 126)))[0], atol=1e-10)
    np.testing.assert_allclose(deviations**2, np.concatenate(learned.variances_), atol=1e-12)


def test_coefficients_stay_within_the_bounds_of_a_model(rng):
    for model in (rig(), Bounded(frames())):
        far = model.displacements(5 * rng.normal(size=(6, model.n_coefficients)))
        found = model.encode(far)
        assert found.min() == model.bounds[0] and found.max() == model.bounds[1]


def test_models_are_told_apart_by_kind_sizes_and_numbers():
    from facelab.posing.fingerprint import differs, fingerprint

    prints = {name: fingerprint(make()) for name, make in MODELS.items()}
    for (a, one), (b, other) in itertools.product(prints.items(), repeat=2):
        assert bool(differs(one, other)) == (a != b)


def test_a_model_without_a_basis_is_none():
    class Empty(FaceModel):
        pass

    with pytest.raises(TypeError, match="basis"):
        Empty()


def test_a_model_that_has_learned_nothing_is_not_posed():
    for nothing in (RegionModel(corner_regions()), HolisticModel()):
        with pytest.raises(NotFittedError):
            PosingSession(nothing, mesh())


# --- a fifth model --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [AveragedFrames, Bounded])
def test_a_fifth_model_poses_saves_and_replays(kind, tmp_path):
    model, face = kind(frames()), mesh()
    session = PosingSession(model, face)
    session.hold(3)
    pull(session, 20, [0.4, 0.9, 0.2])
    session.mold(0, 1, 0.5)
    pull(session, 38, [0.0, -0.5, 0.1])
    assert np.abs(session.vertices - face.vertices).max() > 0.1
    save_pose(tmp_path / "pose.json", session)
    again = PosingSession(kind(frames()), face)
    load_pose(tmp_path / "pose.json", again)
    np.testing.assert_array_equal(again.vertices, session.vertices)
    twin = replay(read_log(tmp_path / "pose.json"), PosingSession(kind(frames()), face))
    np.testing.assert_array_equal(twin.vertices, session.vertices)
    while session.undo():
        pass
    np.testing.assert_array_equal(session.vertices, face.vertices)
    with pytest.raises(ValueError, match="another model"):
        load_pose(tmp_path / "pose.json", PosingSession(rig(), face))


@pytest.mark.parametrize("kind", [AveragedFrames, Bounded])
def test_clips_of_a_fifth_model_are_kept_and_exported(kind, tmp_path, rng):
    session = PosingSession(kind(frames()), mesh())
    clip = Clip([0.0, 1.0], rng.uniform(0, 1, size=(2, 6)), names=["rest", "smile"])
    save_clip(tmp_path / "clip.json", clip, session)
    np.testing.assert_array_equal(load_clip(tmp_path / "clip.json", session).poses, clip.poses)
    write_clip_glb(tmp_path / "clip.glb", clip, session)
    names = pygltflib.GLTF2().load(tmp_path / "clip.glb").meshes[0].extras["targetNames"]
    named = [f"stretch {k}" for k in range(6)]
    assert names == (named if kind is Bounded else ["rest", "smile"])


def test_a_session_goes_from_model_to_model_and_back(tmp_path):
    models = [make() for make in MODELS.values()]
    session = PosingSession(models[0], mesh())
    pull(session, 20, [0.5, 1.0, 0.2])
    for model in models[1:]:
        session.use(model)
        assert session.plausibility() is None or len(session.plausibility()) == len(model.slices)
    fresh = PosingSession(models[0], mesh())
    np.testing.assert_array_equal(replay(session.log, fresh, models).vertices, session.vertices)


def test_recorded_weights_drive_a_rig_and_no_other_model():
    take = WeightSequence(np.zeros((2, 5)), "abcde", 30.0)
    assert PosingSession(rig(), mesh()).encode(take).shape == (2, 5)
    with pytest.raises(TypeError, match="take is a WeightSequence; give a MotionSequence"):
        PosingSession(AveragedFrames(frames()), mesh()).encode(take)


# --- second roads ---------------------------------------------------------------------------------


class ShapesOfARig(FaceModel):
    """A rig's shapes and bounds, and nothing else that a rig knows."""

    bounds = (0.0, 1.0)

    def __init__(self, rig):
        self._rig = rig

    @property
    def basis(self):
        return np.array(self._rig.deltas)


def test_bounds_alone_make_any_basis_pose_as_a_rig(rng):
    shapes = bumpy_rig()
    rig, plain = PoseSolver(shapes), PoseSolver(ShapesOfARig(shapes), mesh=shapes.neutral)
    assert not plain.affine
    for size in (1.0, 50.0):
        pins = {int(v): size * rng.normal(size=3) for v in (5, 60, 100)}
        np.testing.assert_allclose(plain.solve(pins), rig.solve(pins), atol=1e-10)


def test_a_plain_basis_poses_as_given_bases_do(rng):
    model = AveragedFrames(frames())
    given = RegionModel.from_bases(None, np.zeros(126), [model.basis.reshape(6, -1)])
    pins = {7: np.array([1.0, -2, 0.5]), 30: np.array([0.0, 1, 0])}
    np.testing.assert_allclose(
        PoseSolver(model).solve(pins), PoseSolver(given).solve(pins), atol=1e-9
    )
    X = rng.normal(size=(3, 42, 3))
    np.testing.assert_allclose(model.encode(X), given.encode(X), atol=1e-8)


# --- the house ------------------------------------------------------------------------------------


def test_no_room_above_the_models_asks_which_model_it_has():
    kinds = {"RegionModel", "HolisticModel", "GlobalLocalModel", "BlendshapeRig"}
    found = []
    package = Path(facelab.__file__).parent
    for room in ("posing", "files", "widgets"):
        for path in sorted((package / room).glob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance":
                    asked = {n.id for n in ast.walk(node.args[1]) if isinstance(n, ast.Name)}
                    found += [f"{path.name}:{node.lineno}"] * bool(asked & kinds)
    assert found == []
