import doctest
import sys
import warnings

import numpy as np
import pytest
from scipy.optimize import minimize
from shapes import sphere_mesh

from data_synth.action_units import actor_rig
from facelab.expression import landmarks
from facelab.expression.translate import FEW, SHARE, Translator, translate
from facelab.geometry.mesh import TriangleMesh
from facelab.motion import WeightSequence
from facelab.numeric.least_squares import smoothed_sides
from facelab.rig import BlendshapeRig

EXACT = dict(lam=0, smooth=0, near=1)


@pytest.fixture(scope="module")
def rig():
    """Six bumps on a head-sized sphere that hardly overlap."""
    mesh = sphere_mesh(3, radius=100.0)
    rng = np.random.default_rng(3)
    middles = mesh.vertices[rng.choice(mesh.n_vertices, 6, replace=False)]
    away = np.linalg.norm(mesh.vertices - middles[:, None], axis=2)
    deltas = 10 * np.exp(-((away / 30) ** 2))[..., None] * rng.normal(size=(6, 1, 3))
    return BlendshapeRig(mesh, list("abcdef"), deltas)


def rig_of(rig, mixture, names):
    """A rig whose shapes are mixtures of another's."""
    return BlendshapeRig(rig.neutral, names, np.tensordot(mixture, rig.deltas, axes=1))


def take_of(rig, n=40, seed=5, fps=30):
    weights = np.random.default_rng(seed).uniform(0, 1, (n, len(rig.names)))
    return WeightSequence(weights, rig.names, fps)


def test_a_renamed_rig_is_driven_alike(rig):
    other = rig.renamed({n: n.upper() * 2 for n in rig.names})
    take = take_of(rig)
    to = translate(take, rig, other, **EXACT)
    assert to.names == other.names and to.fps == take.fps
    np.testing.assert_allclose(to.weights, take.weights, atol=1e-3)  # the ridge
    assert np.nanmax(to.report.errors) < 0.01


def test_planted_mixtures_are_found_and_told_by_the_map(rig):
    mixture = np.zeros((5, 6))
    mixture[0, [0, 1]] = 1  # one shape for two
    mixture[1, 2] = 2  # twice as large
    mixture[2, 3] = mixture[3, 4] = mixture[4, 5] = 1
    other = rig_of(rig, mixture, ["AB", "C2", "D", "E", "F"])
    pair = Translator(rig, other)
    assert pair.map_of("c") == {"C2": pytest.approx(0.5, abs=0.01)}
    assert set(pair.map_of("a", least=0.1)) == {"AB"}
    a = take_of(rig).weights.copy()
    a[:, 1] = a[:, 0]
    to = pair.translate(WeightSequence(a, rig.names, 30), **EXACT)
    truth = np.c_[a[:, 0], a[:, 2] / 2, a[:, 3:]]
    np.testing.assert_allclose(to.weights, truth, atol=2e-3)


def test_the_answer_minimises_the_energy_as_it_is_written(rig, rng):
    mixture = rng.uniform(0, 1, (4, 6)) * (rng.uniform(size=(4, 6)) < 0.5)
    mixture[np.arange(4), np.arange(4)] = 1
    other = rig_of(rig, mixture, list("PQRS"))
    pair, take = Translator(rig, other), take_of(rig, 3)
    lam, near = 0.5, 0.4
    to = pair.translate(take, lam=lam, smooth=0, near=near)
    A, B = (np.asarray(r.deltas).reshape(len(r.names), -1) for r in (rig, other))
    n = rig.neutral.n_vertices

    def nearest(d, few):
        def cost(b):
            return ((b @ B - d) ** 2).sum() / n + few**2 * b.sum()

        return minimize(cost, np.full(4, 0.3), bounds=[(0, 1)] * 4, tol=1e-12).x

    def few_nearest(d):
        kept = nearest(d, min(FEW, SHARE * np.sqrt((d**2).sum() / n))) > 0.03
        solution = minimize(
            lambda b: ((b @ B - d) ** 2).sum() / n, 0.3 * kept, bounds=[(0, k) for k in kept]
        )
        return solution.x

    M = np.array([few_nearest(d) for d in A])
    np.testing.assert_allclose(pair.map, M, atol=1e-3)
    for a, b in zip(take.weights, to.weights, strict=True):

        def energy(b, a=a):
            far, off = a @ A - b @ B, (b - a @ M) @ B
            return (near * (far**2).sum() + (1 - near) * (off**2).sum()) / n + lam**2 * b.sum()

        best = minimize(energy, np.full(4, 0.3), bounds=[(0, 1)] * 4, tol=1e-12)
        assert energy(b) < best.fun + 1e-4
        np.testing.assert_allclose(b, best.x, atol=5e-3)


def test_errors_are_those_of_the_moved_faces(rig):
    other = rig_of(rig, np.eye(6)[:4], list("abcd"))
    take = take_of(rig, 5)
    to = translate(take, rig, other, **EXACT)
    left = np.tensordot(take.weights, rig.deltas, axes=1)
    size = np.sqrt((left**2).sum(axis=2).mean(axis=1))
    left = left - np.tensordot(to.weights, other.deltas, axes=1)
    errors = np.sqrt((left**2).sum(axis=2).mean(axis=1))
    np.testing.assert_allclose(to.report.errors, errors, atol=1e-6)
    np.testing.assert_allclose(to.report.sizes, size, atol=1e-6)
    assert set(to.report.cannot) == {"e", "f"}
    assert "More than half is left of" in str(to.report)
    assert to.report.shape_errors["e"] == pytest.approx(to.report.shape_sizes["e"], rel=0.2)


def test_a_larger_lam_leaves_fewer_shapes(rig):
    other = rig_of(rig, np.eye(6) + 0.4 * np.roll(np.eye(6), 1, axis=1), list("uvwxyz"))
    pair, take = Translator(rig, other), take_of(rig)
    active = [pair.translate(take, lam, smooth=0).report.active for lam in (0, 0.5, 1.5)]
    assert active[0] > active[1] > active[2]


def test_smoothing_takes_noise_out_and_leaves_what_stands_still(rig, rng):
    pair = Translator(rig, rig.renamed({"a": "A"}))
    still = WeightSequence(np.full((50, 6), 0.5), rig.names, 60)
    np.testing.assert_allclose(pair.translate(still, 0, 0.05).weights, 0.5, atol=1e-3)
    noisy = WeightSequence(0.5 + 0.1 * rng.normal(size=(200, 6)).clip(-3, 3), rig.names, 60)
    shake = [
        np.abs(np.diff(pair.translate(noisy, 0, s).weights, axis=0)).mean() for s in (0, 0.01, 0.05)
    ]
    assert shake[0] > 1.2 * shake[1] > 1.2 * shake[2]


def test_smoothed_sides_are_those_of_the_linear_equations(rng):
    M = rng.normal(size=(8, 4))
    H, G, mu = M.T @ M, rng.normal(size=(9, 4)), 0.7
    T = np.diag(np.r_[1, np.full(7, 2), 1]) - np.eye(9, k=1) - np.eye(9, k=-1)
    w = np.linalg.solve(np.kron(np.eye(9), H) + mu * np.kron(T, np.eye(4)), G.ravel())
    np.testing.assert_allclose(smoothed_sides(H, G, mu), w.reshape(9, 4) @ H, atol=1e-9)


def test_lost_frames_stay_lost_and_nothing_is_smoothed_across(rig):
    pair, take = Translator(rig, rig.renamed({"a": "A"})), take_of(rig, 20)
    valid = np.ones(20, dtype=bool)
    valid[7:9] = False
    weights = np.where(valid[:, None], take.weights, np.nan)
    to = pair.translate(WeightSequence(weights, rig.names, 30, valid), smooth=0.1)
    np.testing.assert_array_equal(to.valid, valid)
    assert np.isnan(to.weights[7:9]).all() and np.isnan(to.report.errors[7:9]).all()
    np.testing.assert_array_equal(to.weights[:7], pair.translate(take[:7], smooth=0.1).weights)


@pytest.fixture(scope="module")
def actors():
    """Two actors with units of their own, one of them on a mesh of its own too."""
    one, two = actor_rig("M1", 4375).linear(), actor_rig("F1", 4375).linear()
    order = np.random.default_rng(0).permutation(two.neutral.n_vertices)
    place = np.argsort(order)
    mesh = TriangleMesh(
        two.neutral.vertices[order],
        place[two.neutral.faces],
        {name: int(place[v]) for name, v in two.neutral.landmarks.items()},
    )
    return one, BlendshapeRig(mesh, two.names, two.deltas[:, order])


def test_an_actors_take_goes_to_another_on_another_mesh_and_back(actors):
    one, two = actors
    there, back = Translator(one, two), Translator(two, one)
    rng = np.random.default_rng(1)
    weights = rng.uniform(0, 1, (60, 40)) * (rng.uniform(size=(60, 40)) < 0.1)
    take = WeightSequence(weights, one.names, 30)
    to = there.translate(take, smooth=0)
    again = back.translate(to, smooth=0)
    lost = np.tensordot(again.weights - weights, one.deltas, axes=1)
    assert np.sqrt((lost**2).sum() / (np.tensordot(weights, one.deltas, axes=1) ** 2).sum()) < 0.1
    assert np.abs(again.weights - weights).mean() < weights.mean() / 3
    k = one.names.index("AU12L")
    assert max(there.map_of("AU12L"), key=there.map_of("AU12L").get) == one.names[k]


def test_the_same_face_is_the_template_whichever_is_named_first(actors):
    one, two = actors
    a, b = Translator(one, two), Translator(two, one)
    np.testing.assert_allclose(a._grams[1], b._grams[1].T, atol=1e-9)
    assert repr(a).startswith("Translator(40 shapes to 40")


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("kind", ["left half", "lower face", "a tenth"])
def test_a_rig_wound_inwards_in_part_gives_the_weights_of_the_other(actors, kind, side):
    def wrong(rig):
        mesh = rig.neutral
        x, y, _ = mesh.vertices[mesh.faces].mean(axis=1).T
        chance = np.random.default_rng(1).random(len(x))
        which = {"left half": x > 0, "lower face": y < -20, "a tenth": chance < 0.1}[kind]
        faces = np.where(which[:, None], mesh.faces[:, ::-1], mesh.faces)
        return BlendshapeRig(
            TriangleMesh(mesh.vertices, faces, mesh.landmarks), rig.names, rig.deltas
        )

    take = take_of(actors[0], 5)
    pair = [wrong(rig) if i == side else rig for i, rig in enumerate(actors)]
    with pytest.warns(UserWarning, match=r"^(rig|other|scan): .* wound inwards"):
        to = translate(take, *pair)
    np.testing.assert_allclose(to.weights, translate(take, *actors).weights, atol=0.01)


def test_weights_that_make_next_to_nothing_of_a_take_are_said(actors):
    one, _ = actors
    order = np.roll(np.arange(one.neutral.n_vertices), 1)  # of the vertices of all its shapes
    other = BlendshapeRig(one.neutral, one.names, -one.deltas[:, order])
    smile = WeightSequence(np.eye(40)[[one.names.index("AU12R")]], one.names, 30)
    with pytest.warns(UserWarning, match="make next to nothing of it"):
        report = translate(smile, one, other).report
    assert report.errors[0] > 0.9 * report.sizes[0]


@pytest.mark.parametrize("way", [1, -1])
def test_how_much_of_the_motion_is_compared_is_said(actors, way):
    one, two = actors
    left = two.neutral.vertices[:, 0] > -8
    half = BlendshapeRig(two.neutral.submesh(left), two.names, two.deltas[:, left])
    pair = (one, half)[::way]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the fit
        there = Translator(*pair)
    names = list(one.names)
    right, jaw = np.eye(40)[[names.index("AU12R")]], np.eye(40)[[names.index("AU27")]]
    if way == 1:
        assert there.compared(right) < 0.2 and 0.3 < there.compared(jaw) < 0.8
        with pytest.warns(UserWarning, match="of what the take moves lies where both rigs have"):
            report = there.translate(WeightSequence(right, names, 30)).report
        assert f"{100 * there.compared(right):.0f} % of this motion lies there" in str(report)
    else:  # what the half moves, the whole has
        assert there.compared(jaw) > 0.9
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Translator(one, two).translate(WeightSequence(jaw, names, 30)).report.compared > 0.95
        same = translate(WeightSequence(jaw, names, 30), one, one.renamed({"AU27": "A"}))
    assert same.report.compared == 1 and "Compared" not in str(same.report)


def test_what_is_no_rig_or_take_is_refused(rig):
    with pytest.raises(TypeError, match=r"other is a TriangleMesh.*BlendshapeRig"):
        Translator(rig, rig.neutral)
    pair = Translator(rig, rig)
    with pytest.raises(TypeError, match="take is a"):
        pair.translate(np.zeros((3, 6)))
    take = take_of(rig, 2)
    for wrong in (dict(lam=-1), dict(smooth=-1), dict(near=1.5)):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            pair.translate(take, **wrong)
    with pytest.raises(ValueError, match="no recorded name drives this rig"):
        pair.translate(WeightSequence([[0.5]], ["Nase"], 30))
    with pytest.raises(ValueError, match="unknown shape"):
        pair.map_of("nod")


def test_heads_that_stand_otherwise_are_refused(actors):
    rig, other = actors
    turn = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T  # z up
    mesh = TriangleMesh(other.neutral.vertices @ turn, other.neutral.faces, other.neutral.landmarks)
    for marks in (mesh.landmarks, {n.upper(): v for n, v in mesh.landmarks.items()}):
        lying = BlendshapeRig(
            TriangleMesh(mesh.vertices, mesh.faces, marks), other.names, other.deltas @ turn
        )
        with pytest.raises(
            ValueError, match=r"other is turned by (8\d|9\d) degrees .* about \(1\.0, "
        ):
            Translator(rig, lying)


@pytest.mark.parametrize("still", ["rig", "other"])
def test_a_rig_whose_shapes_move_nothing_is_refused(rig, still):
    pair = {"rig": rig, "other": rig.renamed({"a": "A"})}
    pair[still] = BlendshapeRig(rig.neutral, rig.names, 1e-3 * rig.deltas)
    with pytest.raises(ValueError, match=f"{still}: its 6 shapes move the face by less than"):
        Translator(**pair)


def test_the_examples_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for module in (sys.modules[Translator.__module__], landmarks):
        failed, tried = doctest.testmod(module)
        assert tried and not failed
