import literal
import numpy as np
import pytest
from planted import bumps, corner_regions, quarters, three_strips
from real_face import LIDS, PULLED, control_face, models
from scipy.spatial import Delaunay
from shapes import grid_mesh
from sklearn.decomposition import PCA

from facelab.deformation import bind
from facelab.mesh import TriangleMesh
from facelab.models import HolisticModel, RegionModel
from facelab.posing import REFERENCE_VERTICES, PoseSolver, PosingSession
from facelab.segmentation import Regions


def fitted(regions, rng, n_components=5):
    """A region model of random motion: nothing in it is special, boundaries disagree."""
    X = rng.normal(size=(50, 3 * regions.mesh.n_vertices)) + 1.0
    return RegionModel(regions, n_components).fit(X)


def skewed(model, rng):
    """The model with bases that are neither orthogonal nor of length one."""
    components = [rng.normal(size=(len(B), len(B))) @ B for B in model.components_]
    return model._set_bases(model.columns_, components, model.variances_)


def literal_solution(model, pins, c_0, beta, gamma):
    """Eq. 10 with the weights that beta and gamma have on a mesh of this density."""
    bases = [B.T for B in model.components_]
    density = REFERENCE_VERTICES / (len(model.mean_) / 3)
    return literal.eq_10(
        pins,
        model.members_,
        bases,
        literal.split(c_0, bases),
        beta * np.sqrt(density),
        gamma * density,
    )


def held_by(regions, count):
    """Vertices of so many regions; of 3 or more where 3 are asked for."""
    return np.flatnonzero(np.minimum(regions.holders, 3) == count)


@pytest.fixture
def regions():
    return corner_regions()


@pytest.fixture
def model(regions, rng):
    return fitted(regions, rng)


@pytest.fixture
def session(model, regions):
    return PosingSession(model, regions.mesh)


def pull(session, vertex, by):
    """Drag a vertex by some millimetres from where it is, and let go."""
    session.drag(vertex, session.vertices[vertex] + by)
    session.release()


def story(session):
    """All that a failing action must leave alone."""
    return (
        session.vertices.copy(),
        {v: t.copy() for v, t in session.pins.items()},
        session.state,
        len(session._past),
        list(session._future),
        session._drag is not None,
    )


def assert_same_story(session, before):
    vertices, pins, *rest = story(session)
    np.testing.assert_array_equal(vertices, before[0])
    assert pins.keys() == before[1].keys()
    for v, t in pins.items():
        np.testing.assert_array_equal(t, before[1][v])
    assert all(a is b or a == b for a, b in zip(rest, before[2:], strict=True))


# --- the solver: Eq. 8 to 10 ----------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.025, 1.0])
@pytest.mark.parametrize("n_pins", [1, 3])
def test_one_region_is_posed_by_equation_8(rng, grid, gamma, n_pins):
    model = HolisticModel(6).fit(rng.normal(size=(40, 90)))
    vertices = rng.choice(30, n_pins, replace=False)
    pins = {int(v): rng.normal(size=3) for v in vertices}
    c_0 = rng.normal(size=6)
    B = model.components_[0].T
    # a second road: Eq. 8 as stacked least squares
    root = np.sqrt(gamma * REFERENCE_VERTICES / 30)
    A = np.vstack([*(B[3 * v : 3 * v + 3] for v in pins), root * np.eye(6)])
    b = np.concatenate([*pins.values(), root * c_0])
    np.testing.assert_allclose(
        PoseSolver(model, gamma=gamma).solve(pins, c_0), np.linalg.lstsq(A, b)[0], atol=1e-10
    )


@pytest.mark.parametrize("beta", [0.0, 0.5, 30.0])
@pytest.mark.parametrize("gamma", [0.025, 2.0])
@pytest.mark.parametrize("orthonormal", [True, False])
@pytest.mark.parametrize("pinned", ["interior", "shared", "several"])
def test_pins_on_copies_are_equation_10_to_the_letter(
    rng, model, regions, beta, gamma, orthonormal, pinned
):
    model = model if orthonormal else skewed(model, rng)
    vertices = {
        "interior": held_by(regions, 1)[:1],
        "shared": held_by(regions, 3)[:1],
        "several": [held_by(regions, 1)[4], held_by(regions, 2)[0], held_by(regions, 3)[0]],
    }[pinned]
    pins = {int(v): rng.normal(size=3) for v in vertices}
    for c_0 in (np.zeros(20), rng.normal(size=20)):
        ours = PoseSolver(model, beta, gamma, shared_pins="copies").solve(pins, c_0)
        theirs = literal_solution(model, pins, c_0, beta, gamma)
        # a system of condition up to 1e4 solved twice
        np.testing.assert_allclose(ours, theirs, atol=1e-10)


def test_on_as_many_vertices_as_the_paper_had_nothing_is_scaled(rng):
    mesh = TriangleMesh(
        rng.normal(size=(397, 3)), np.stack([np.arange(395) + i for i in range(3)], axis=1)
    )
    model = fitted(Regions(np.arange(397) * 3 // 397, mesh), rng, n_components=3)
    bases = [B.T for B in model.components_]
    pins, c_0 = {131: np.array([1.0, 2, 3]), 300: np.array([0.0, -1, 0])}, rng.normal(size=9)
    theirs = literal.eq_10(pins, model.members_, bases, literal.split(c_0, bases), 0.5, 0.025)
    ours = PoseSolver(model, 0.5, 0.025, shared_pins="copies").solve(pins, c_0)
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("sharing", ["one-sided", "both", "none"])
def test_blended_pins_are_pins_on_copies_where_one_region_holds_each(rng, sharing):
    regions = corner_regions(sharing)
    model = fitted(regions, rng)
    pins = {int(v): rng.normal(size=3) for v in held_by(regions, 1)[:3]}
    c_0 = rng.normal(size=20)
    blended, copies = (
        PoseSolver(model, shared_pins=kind).solve(pins, c_0) for kind in ("blended", "copies")
    )
    np.testing.assert_allclose(blended, copies, atol=1e-12)


def test_pins_on_copies_and_on_their_mean_differ_where_the_copies_disagree(rng, model, regions):
    pins = {int(held_by(regions, 3)[0]): np.array([2.0, 0, 0])}
    blended, copies = (
        PoseSolver(model, shared_pins=kind).solve(pins) for kind in ("blended", "copies")
    )
    assert np.abs(blended - copies).max() > 1e-3


def test_no_other_coefficients_have_a_lower_energy(rng, model, regions):
    bases = [B.T for B in model.components_]
    pins = {5: rng.normal(size=3), int(held_by(regions, 2)[0]): rng.normal(size=3)}
    c_0 = rng.normal(size=20)
    density = REFERENCE_VERTICES / 42

    def energy(zeta):
        c, before = literal.split(zeta, bases), literal.split(c_0, bases)
        beta, gamma = 0.5 * np.sqrt(density), 0.025 * density
        return literal.eq_9(pins, model.members_, bases, c, before, beta, gamma)

    best = PoseSolver(model, shared_pins="copies").solve(pins, c_0)
    for size in (1e-3, 0.1, 10):
        for _ in range(10):
            assert energy(best + size * rng.normal(size=20)) > energy(best)


def test_a_blended_pin_holds_the_vertex_that_is_seen(rng, model, regions):
    solver = PoseSolver(model)
    zeta = rng.normal(size=20)
    for v in (held_by(regions, 1)[0], held_by(regions, 2)[0], held_by(regions, 3)[0]):
        seen = solver.displacements(zeta)[0, v]
        weight = np.sqrt(regions.holders[v])
        np.testing.assert_allclose(solver.rows(v) @ zeta, weight * seen, atol=1e-12)


def test_without_pins_and_without_gaps_nothing_moves(rng, model):
    assert (PoseSolver(model).solve({}) == 0).all()


def test_the_sensitivity_is_the_slope_of_the_solution(rng, model, regions):
    for shared_pins in ("blended", "copies"):
        solver = PoseSolver(model, shared_pins=shared_pins)
        pins = {3: rng.normal(size=3), int(held_by(regions, 3)[0]): rng.normal(size=3)}
        for moving in pins:
            slope = solver.sensitivity(list(pins), moving)
            for axis in range(3):
                further = {**pins, moving: pins[moving] + np.eye(3)[axis]}
                change = solver.solve(further) - solver.solve(pins)
                np.testing.assert_allclose(slope[:, axis], change, atol=1e-10)


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"beta": -0.1}, ValueError, "beta=-0.1"),
        ({"gamma": 0}, ValueError, "gamma=0"),
        ({"gamma": np.nan}, ValueError, "gamma=nan"),
        ({"beta": "much"}, TypeError, "beta='much'"),
        ({"shared_pins": "all"}, ValueError, "shared_pins='all'"),
    ],
)
def test_the_solver_names_the_parameter_out_of_range(model, settings, error, message):
    with pytest.raises(error, match=message):
        PoseSolver(model, **settings)


# --- limits ---------------------------------------------------------------------------------------


def test_a_large_gamma_freezes_the_face(model, regions):
    session = PosingSession(model, regions.mesh, gamma=1e9)
    pull(session, 8, [10.0, 0, 0])
    # 10 mm against a resistance of 1e9 and more
    assert np.abs(session.vertices - regions.mesh.vertices).max() < 1e-6


@pytest.mark.parametrize("holders", [1, 2, 3])
def test_a_small_gamma_brings_the_vertex_to_its_target(rng, regions, holders):
    X = rng.normal(size=(40, 4)) @ rng.normal(size=(4, 126))  # all regions can go there together
    session = PosingSession(RegionModel(regions, 4).fit(X), regions.mesh, gamma=1e-9)
    v = int(held_by(regions, holders)[0])
    target = regions.mesh.vertices[v] + [3.0, -2, 4]
    session.drag(v, target)
    np.testing.assert_allclose(session.vertices[v], target, atol=1e-3)


def test_the_vertex_follows_less_the_larger_gamma_is(model, regions):
    reached = []
    for gamma in (1e-4, 1e-3, 0.025, 0.5, 10):
        session = PosingSession(model, regions.mesh, gamma=gamma)
        session.drag(8, regions.mesh.vertices[8] + [0.0, 5, 0])
        reached.append(session.vertices[8, 1] - regions.mesh.vertices[8, 1])
    assert (np.diff(reached) < 0).all()
    assert 0 < reached[-1] < reached[0] < 5


@pytest.mark.parametrize("holders", [1, 2, 3])
def test_without_beta_only_regions_that_hold_the_pin_move(model, regions, holders):
    session = PosingSession(model, regions.mesh, beta=0)
    v = int(held_by(regions, holders)[0])
    pull(session, v, [0.0, 0, 5])
    moved = np.abs(session.vertices - regions.mesh.vertices).max(axis=1) > 0
    near = np.unique(np.concatenate([m for m in regions.members if v in m]))
    assert not moved[np.setdiff1d(np.arange(42), near)].any()
    assert moved[near].all()


def test_beta_draws_the_neighbours_along(rng):
    regions = three_strips()
    model = fitted(regions, rng)
    far = np.setdiff1d(np.arange(45), regions.members[0])
    v = int(regions.members[0][0])
    moved = []
    for beta in (0, 0.01, 0.1, 1):
        session = PosingSession(model, regions.mesh, beta=beta)
        pull(session, v, [0.0, 0, 5])
        moved.append(np.abs(session.vertices - regions.mesh.vertices)[far].sum())
    assert moved[0] == 0
    assert (np.diff(moved) > 0).all()


def test_regions_move_less_far_away_than_the_whole_face_model(rng):
    mesh, labels = quarters(12, 10)
    X = bumps(mesh, labels, rng)
    # the motion has eight modes; a model of four of them for the whole face has to mix patches
    local = RegionModel(Regions(labels, mesh), 4).fit(X)
    whole = HolisticModel(4).fit(X)
    shares = np.zeros((2, 4))
    for patch, v in enumerate([2 * 12 + 2, 2 * 12 + 9, 7 * 12 + 2, 7 * 12 + 9]):
        far = np.linalg.norm(mesh.vertices - mesh.vertices[v], axis=1) > 50
        for row, model in zip(shares, (local, whole), strict=True):
            session = PosingSession(model, mesh)
            pull(session, v, [0.0, 0, 8])
            energy = np.sum((session.vertices - mesh.vertices) ** 2, axis=1)
            row[patch] = energy[far].sum() / energy.sum()
    assert (shares[0] < shares[1]).all()
    assert shares[0].mean() < 0.2 * shares[1].mean()


# --- the session: dragging ------------------------------------------------------------------------


def test_an_untouched_session_shows_the_exact_neutral_even_where_the_model_cannot(rng, regions):
    model = fitted(regions, rng, n_components=2)
    x = model.reconstruct(np.zeros((1, 126)))
    assert np.abs(x).max() > 0.01, "the example should not express the neutral"
    session = PosingSession(model, regions.mesh)
    np.testing.assert_array_equal(session.vertices, regions.mesh.vertices)
    assert session.pins == {}
    assert (session.beta, session.gamma) == (0.5, 0.025)


@pytest.mark.parametrize("kept", [False, True])
def test_a_drag_along_a_path_shows_what_solving_anew_gives(rng, session, regions, kept):
    pull(session, 3, [2.0, 1, 0])
    if kept:
        session.keep()
    pull(session, 30, [0.0, 0, -3])
    v = int(held_by(regions, 3)[0])
    start = session.vertices[v]
    session.press(v)
    for step in np.cumsum(rng.normal(size=(6, 3)), axis=0):
        session.drag(v, start + step)
        shown = session.vertices
        anew = PosingSession(session.model, regions.mesh)
        anew._past = [session.state]
        anew._step(pins={**session.state.pins, v: start + step - regions.mesh.vertices[v]})
        np.testing.assert_allclose(shown, anew.vertices, atol=1e-9)
    session.release()
    np.testing.assert_allclose(session.vertices, shown, atol=1e-9)


def test_from_the_neutral_the_session_shows_the_solution_of_the_solver(session, regions, model):
    pull(session, 3, [2.0, 1, 0])
    pull(session, 30, [0.0, 0, -3])
    pins = {v: t - regions.mesh.vertices[v] for v, t in session.pins.items()}
    expected = regions.mesh.vertices + PoseSolver(model).displacements(
        PoseSolver(model).solve(pins)
    )
    np.testing.assert_allclose(session.vertices, expected[0], atol=1e-10)


def test_pressing_tells_how_the_face_will_follow(session, regions):
    D = session.press(8)
    assert D.shape == (42, 3, 3)
    session.drag(8, regions.mesh.vertices[8] + [0.0, 3, -1])
    np.testing.assert_allclose(session.vertices, regions.mesh.vertices + D @ [0, 3, -1], atol=1e-12)


# pressing adds a pin where the vertex is: nothing but rounding may move


@pytest.mark.parametrize("kept", ["neutral", "pins", "kept", "kept and pins"])
@pytest.mark.parametrize("shared_by", [1, 2, 3])
def test_pressing_anywhere_changes_nothing(session, regions, kept, shared_by):
    if kept != "neutral":
        pull(session, 3, [4.0, 1, 0])
        pull(session, int(held_by(regions, 2)[-1]), [0.0, 3, -3])
    if "kept" in kept:
        session.keep()
    if kept == "kept and pins":
        pull(session, 25, [0.0, -2, 2])
    before = session.vertices
    for v in held_by(regions, shared_by)[:4]:
        session.press(int(v))
        np.testing.assert_allclose(session.vertices, before, atol=1e-9)
        session.release()
        np.testing.assert_allclose(session.vertices, before, atol=1e-9)


def test_twenty_presses_do_not_drift(rng, session):
    pull(session, 3, [4.0, 1, 0])
    before = session.vertices
    for v in rng.integers(42, size=20):
        session.press(int(v))
        session.release()
    np.testing.assert_allclose(session.vertices, before, atol=1e-9)


def test_keeping_twenty_times_does_not_drift(session):
    pull(session, 3, [4.0, 1, 0])
    before = session.vertices
    for _ in range(20):
        session.keep()
        session.press(9)
        session.release()
    np.testing.assert_allclose(session.vertices, before, atol=1e-9)


def test_a_pin_pressed_again_keeps_its_target(session):
    pull(session, 3, [4.0, 1, 0])
    target, before = session.pins[3], session.vertices
    assert np.linalg.norm(session.vertices[3] - target) > 0.01  # it stops short of it
    session.press(3)
    session.release()
    np.testing.assert_array_equal(session.pins[3], target)
    np.testing.assert_allclose(session.vertices, before, atol=1e-9)


def test_pressing_another_vertex_lets_go_of_the_first(session, regions):
    session.drag(3, regions.mesh.vertices[3] + [1.0, 0, 0])
    session.drag(20, regions.mesh.vertices[20] + [0.0, 1, 0])
    session.release()
    assert set(session.pins) == {3, 20}
    assert len(session._past) == 3


def test_a_drag_shows_in_the_pins_and_not_in_the_state(session, regions):
    session.drag(3, regions.mesh.vertices[3] + [1.0, 0, 0])
    assert set(session.pins) == {3}
    assert dict(session.state.pins) == {}


def test_a_drag_given_up_never_was(session, regions):
    pull(session, 30, [0.0, 0, -3])
    before = story(session)
    session.drag(3, regions.mesh.vertices[3] + [9.0, 0, 0])
    session.cancel()
    assert_same_story(session, before)
    session.release()
    session.cancel()
    assert_same_story(session, before)


def test_a_target_given_is_not_held_by_reference(session, regions):
    target = regions.mesh.vertices[3] + [1.0, 0, 0]
    session.drag(3, target)
    session.release()
    before = story(session)
    target += 100
    session.pins[3][:] = 0
    assert_same_story(session, before)


# --- the session: edits ---------------------------------------------------------------------------


def edits(rng, regions):
    """One of each thing a person can do."""
    other = fitted(regions, rng, n_components=3)
    return {
        "first pin": lambda s: pull(s, 3, [2.0, 1, 0]),
        "second pin": lambda s: pull(s, int(held_by(regions, 3)[0]), [0.0, 0, -3]),
        "moved pin": lambda s: pull(s, 3, [0.0, 2, 0]),
        "beta": lambda s: s.set(beta=3.0),
        "gamma": lambda s: s.set(gamma=0.5),
        "both": lambda s: s.set(beta=0.1, gamma=0.01),
        "unpin": lambda s: s.remove_pin(3),
        "model": lambda s: s.use(other),
        "keep": lambda s: s.keep(),
        "after keep": lambda s: pull(s, 11, [1.0, 0, 1]),
        "reset": lambda s: s.reset(),
    }


def test_undo_and_redo_walk_through_every_edit_to_the_bit(rng, session, regions):
    seen = [(session.vertices, session.state, session.pins)]
    for edit in edits(rng, regions).values():
        edit(session)
        seen.append((session.vertices, session.state, session.pins))
    steps = [*range(len(seen) - 2, -1, -1)]
    for walk, order in ((session.undo, steps), (session.redo, range(1, len(seen)))):
        for i in order:
            assert walk() is True
            np.testing.assert_array_equal(session.vertices, seen[i][0])
            assert session.state is seen[i][1]
            assert session.pins.keys() == seen[i][2].keys()
        assert walk() is False
    assert session.beta == seen[-1][1].beta


def test_every_edit_is_one_step(rng, session, regions):
    for count, edit in enumerate(edits(rng, regions).values(), start=2):
        edit(session)
        assert len(session._past) == count


def test_a_new_edit_clears_what_was_undone(session):
    pull(session, 3, [2.0, 1, 0])
    pull(session, 20, [2.0, 1, 0])
    session.undo()
    pull(session, 30, [0.0, 0, 1])
    assert session.redo() is False
    assert set(session.pins) == {3, 30}


def test_undo_during_a_drag_gives_the_drag_up_and_nothing_else(session, regions):
    pull(session, 3, [2.0, 1, 0])
    before = story(session)
    session.drag(20, regions.mesh.vertices[20] + [5.0, 0, 0])
    assert session.undo() is True
    assert_same_story(session, before)


def test_undoing_after_redo_during_a_drag_comes_back(session, regions):
    pull(session, 3, [2.0, 1, 0])
    after = session.vertices
    session.undo()
    session.drag(20, regions.mesh.vertices[20] + [5.0, 0, 0])
    assert session.redo() is True
    np.testing.assert_array_equal(session.vertices, after)


def test_setting_what_is_set_already_is_no_step(session):
    pull(session, 3, [2.0, 1, 0])
    before = story(session)
    session.set(beta=0.5, gamma=0.025)
    session.set()
    session.use(session.model)
    assert_same_story(session, before)


def test_a_kept_pose_stays_and_pins_start_from_it(session):
    pull(session, 3, [4.0, 1, 0])
    pose = session.vertices
    session.keep()
    np.testing.assert_array_equal(session.vertices, pose)
    assert session.pins == {}
    pull(session, 30, [0.0, 0, -3])
    session.remove_pin(30)
    # without pins the face is where it was kept, but for rounding
    np.testing.assert_allclose(session.vertices, pose, atol=1e-12)


def test_reset_is_the_exact_neutral_with_the_same_weights(session, regions):
    session.set(beta=2.0, gamma=0.1)
    pull(session, 3, [4.0, 1, 0])
    session.keep()
    pull(session, 20, [4.0, 1, 0])
    session.reset()
    np.testing.assert_array_equal(session.vertices, regions.mesh.vertices)
    assert session.pins == {}
    assert (session.beta, session.gamma) == (2.0, 0.1)


def test_a_pin_taken_away_leaves_the_pose_of_the_others(session, regions, model):
    pull(session, 3, [2.0, 1, 0])
    target = session.pins[3]
    pull(session, 20, [0.0, 0, -3])
    session.remove_pin(20)
    alone = PosingSession(model, regions.mesh)
    alone.drag(3, target)
    np.testing.assert_allclose(session.vertices, alone.vertices, atol=1e-9)
    session.remove_pin(3)
    np.testing.assert_allclose(session.vertices, regions.mesh.vertices, atol=1e-12)


def test_the_order_of_pins_does_not_matter(model, regions):
    targets = {v: regions.mesh.vertices[v] + d for v, d in ((3, [2.0, 1, 0]), (20, [0.0, 0, -3]))}
    one, two = PosingSession(model, regions.mesh), PosingSession(model, regions.mesh)
    for session, order in ((one, [3, 20]), (two, [20, 3])):
        for v in order:
            session.drag(v, targets[v])
        session.release()
    np.testing.assert_allclose(one.vertices, two.vertices, atol=1e-9)


def test_beta_and_gamma_solve_the_same_pins_anew(session, regions, model):
    pull(session, 3, [2.0, 1, 0])
    pull(session, 20, [0.0, 0, -3])
    session.set(beta=5.0, gamma=0.3)
    anew = PosingSession(model, regions.mesh, beta=5.0, gamma=0.3)
    for v, target in session.pins.items():
        anew.drag(v, target)
    np.testing.assert_allclose(session.vertices, anew.vertices, atol=1e-9)


def test_another_model_takes_the_pins_over(rng, session, regions):
    pull(session, 3, [2.0, 1, 0])
    pull(session, 20, [0.0, 0, -3])
    before = session.pins
    other = HolisticModel(8).fit(rng.normal(size=(40, 126)))
    session.use(other)
    assert session.model is other
    assert session.pins.keys() == before.keys()
    for v in before:
        np.testing.assert_array_equal(session.pins[v], before[v])
    anew = PosingSession(other, regions.mesh)
    for v, target in before.items():
        anew.drag(v, target)
    np.testing.assert_allclose(session.vertices, anew.vertices, atol=1e-9)


def test_another_model_without_pins_still_shows_the_neutral(rng, session, regions):
    session.use(HolisticModel(8).fit(rng.normal(size=(40, 126)) + 3.0))
    np.testing.assert_allclose(session.vertices, regions.mesh.vertices, atol=1e-12)


def test_a_kept_pose_is_expressed_in_another_model_as_well_as_it_can_be(rng, regions):
    X = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 126))  # both models express it all
    session = PosingSession(RegionModel(regions, 3).fit(X), regions.mesh, beta=1e4)
    pull(session, 3, [2.0, 1, 0])
    session.keep()
    pose = session.vertices
    session.use(HolisticModel(3).fit(X))
    # a stiff boundary makes the regions one: what is left of their gaps shows as a difference
    np.testing.assert_allclose(session.vertices, pose, atol=1e-2)


def of_another_face(rng):
    return HolisticModel(3).fit(rng.normal(size=(10, 99)))


FAILING = {
    "no target": (lambda s, _: s.drag(3, [np.nan, 0, 0]), ValueError, "NaN"),
    "endless target": (lambda s, _: s.drag(3, [np.inf, 0, 0]), ValueError, "infinite"),
    "flat target": (lambda s, _: s.drag(3, [1.0, 2.0]), ValueError, "target has shape"),
    "unknown vertex": (lambda s, _: s.drag(42, [0.0, 0, 0]), ValueError, "vertex=42"),
    "negative vertex": (lambda s, _: s.press(-1), ValueError, "vertex=-1"),
    "half a vertex": (lambda s, _: s.press(1.5), TypeError, "vertex=1.5"),
    "no vertex": (lambda s, _: s.handle(42), ValueError, "vertex=42"),
    "beta": (lambda s, _: s.set(beta=-1, gamma=1.0), ValueError, "beta=-1"),
    "gamma": (lambda s, _: s.set(beta=1.0, gamma=0), ValueError, "gamma=0"),
    "text": (lambda s, _: s.set(gamma="small"), TypeError, "gamma='small'"),
    "no pin": (lambda s, _: s.remove_pin(7), ValueError, "7 is not pinned; pinned are: 3"),
    "pin beyond": (lambda s, _: s.remove_pin(99), ValueError, "vertex=99"),
    "another face": (lambda s, r: s.use(of_another_face(r)), ValueError, "33 vertices, but 42"),
    "not fitted": (lambda s, _: s.use(HolisticModel(3)), ValueError, "not fitted"),
    "another kind": (
        lambda s, r: s.use(PCA(3).fit(r.normal(size=(10, 126)))),
        TypeError,
        "PCA",
    ),
    "no model": (lambda s, _: s.use("model"), TypeError, "str"),
}


@pytest.mark.parametrize("dragging", [False, True])
@pytest.mark.parametrize("name", FAILING)
def test_an_action_that_fails_leaves_everything_as_it_was(rng, session, regions, name, dragging):
    action, error, message = FAILING[name]
    pull(session, 3, [2.0, 1, 0])
    session.set(beta=2.0)
    session.undo()  # so that there is something to redo
    if dragging:
        session.drag(20, regions.mesh.vertices[20] + [0.0, 3, 0])
    before = story(session)
    with pytest.raises(error, match=message):
        action(session, rng)
    assert_same_story(session, before)


def test_a_session_refuses_parts_that_do_not_belong_together(rng, model, grid):
    with pytest.raises(ValueError, match="the model has 42 vertices, but 30 are to be posed"):
        PosingSession(model, grid)
    with pytest.raises(ValueError, match="binding carries 42 vertices, but neutral has 30"):
        PosingSession(model, grid, binding=bind(grid_mesh(7, 6), [0, 5, 30]))
    with pytest.raises(TypeError, match="RegionModel"):
        PosingSession("model", grid)


# --- a dense face bound to the control vertices ---------------------------------------------------


@pytest.fixture
def bound(rng):
    """A session on a dense grid whose control vertices are every third."""
    dense = grid_mesh(19, 16, 3.0)
    row, column = np.divmod(np.arange(dense.n_vertices), 19)
    samples = np.flatnonzero((row % 3 == 0) & (column % 3 == 0))
    model = fitted(corner_regions(), rng)
    return PosingSession(model, dense, binding=bind(dense, samples))


def test_control_vertices_of_a_bound_face_go_where_the_control_face_goes(bound):
    control = PosingSession(bound.model, corner_regions().mesh)
    samples = bound.binding.samples
    for v, by in ((8, [3.0, 1, 0]), (25, [0.0, 0, -2])):
        pull(control, v, by)
        pull(bound, int(samples[v]), by)
        expected = control.vertices - control.neutral.vertices
        moved = bound.vertices - bound.neutral.vertices
        np.testing.assert_allclose(moved[samples], expected, atol=1e-9)


def test_a_dense_pin_snaps_to_its_handle(bound):
    v = int(np.flatnonzero(bound.neutral.vertices[:, 0] == 3.0)[5])
    handle = bound.handle(v)
    assert handle != v
    assert handle in bound.binding.samples
    assert bound.handle(handle) == handle
    bound.drag(v, bound.neutral.vertices[v] + [0.0, 0, 4])
    bound.release()
    assert set(bound.pins) == {handle}
    np.testing.assert_allclose(
        bound.pins[handle], bound.neutral.vertices[handle] + [0, 0, 4], atol=1e-12
    )


def test_the_neighbour_of_a_handle_pulled_by_nothing_moves_nothing_in_any_pose(bound):
    pull(bound, int(bound.binding.samples[8]), [5.0, 3, 4])
    before = bound.vertices
    pinned = set(bound.pins)
    for v in range(0, bound.neutral.n_vertices, 17):
        if bound.handle(v) not in pinned:
            bound.drag(v, before[v])
            np.testing.assert_allclose(bound.vertices, before, atol=1e-9)
            bound.cancel()


def test_pulling_a_neighbour_pulls_the_handle_by_as_much(bound):
    pull(bound, int(bound.binding.samples[8]), [5.0, 3, 4])
    v = int(np.setdiff1d(np.arange(304), bound.binding.samples)[100])
    handle, start = bound.handle(v), bound.vertices
    bound.drag(v, start[v] + [1.0, 2, 3])
    np.testing.assert_allclose(bound.pins[handle], start[handle] + [1, 2, 3], atol=1e-9)


def test_pressing_a_bound_face_anywhere_changes_nothing(bound):
    pull(bound, int(bound.binding.samples[8]), [5.0, 3, 4])
    bound.keep()
    pull(bound, 200, [0.0, 3, 0])
    before = bound.vertices
    for v in range(0, bound.neutral.n_vertices, 23):
        bound.press(v)
        bound.release()
        np.testing.assert_allclose(bound.vertices, before, atol=1e-9)


def test_a_drag_of_a_bound_face_shows_what_solving_anew_gives(bound):
    bound.drag(77, bound.neutral.vertices[77] + [2.0, -3, 1])
    shown = bound.vertices
    bound.release()
    np.testing.assert_allclose(bound.vertices, shown, atol=1e-9)


# --- density --------------------------------------------------------------------------------------


def smooth_motion(mesh, n_frames=60):
    """Displacements that are waves over the plane, whatever the mesh that samples them."""
    rng = np.random.default_rng(7)
    X = np.zeros((n_frames, mesh.n_vertices, 3))
    for strength in np.geomspace(4, 0.5, 10):
        k, phase = rng.normal(scale=0.025, size=3), rng.uniform(0, 6)
        shape = np.cos(mesh.vertices @ k + phase)[:, None] * rng.normal(size=3)
        X += strength * rng.normal(size=(n_frames, 1, 1)) * shape
    return X.reshape(n_frames, -1)


@pytest.mark.parametrize("beta", [0, 0.5, 5.0])
@pytest.mark.parametrize("gamma", [0.005, 0.025, 0.1])
@pytest.mark.parametrize("uneven", [False, True])
def test_a_finer_grid_answers_a_pin_as_the_coarse_one_does(beta, gamma, uneven):
    coarse, labels = quarters(20, 19, 8.0)
    dense = grid_mesh(77, 73, 2.0)
    row, column = np.divmod(np.arange(coarse.n_vertices), 20)
    samples = 4 * row * 77 + 4 * column
    regions = Regions(labels, coarse)
    carried = regions.carried_to(dense, samples)
    if uneven:  # the left half without three of four columns and rows, as a cheek among lips
        row, column = np.divmod(np.arange(dense.n_vertices), 77)
        keep = (column >= 38) | ((row % 4 == 0) & (column % 4 == 0))
        keep[samples] = True
        V = dense.vertices[keep]
        dense, samples, carried = triangulated(V, keep, samples, carried)
    answers = []
    for mesh, cut, pins in ((coarse, regions, np.arange(380)), (dense, carried, samples)):
        solver = PoseSolver(RegionModel(cut, 6).fit(smooth_motion(mesh)), beta, gamma)
        found = []
        for v in (45, 110, 171, 208, 273, 335):
            x = solver.displacements(solver.solve({int(pins[v]): np.array([2.0, 5, 6])}))[0, pins]
            found.append((np.linalg.norm(x[v]), reach(x, coarse, v, np.ones(380))))
        answers.append(found)
    # waves of 100 mm and more on cells of 8 mm: sums and integrals differ by a few per cent
    np.testing.assert_allclose(answers[1], answers[0], rtol=0.1)


def delaunay(V):
    return TriangleMesh(V, Delaunay(V[:, :2]).simplices)


def triangulated(V, keep, samples, carried):
    """A Delaunay mesh of the vertices kept, with the samples and regions on it."""
    mesh = delaunay(V)
    new = np.cumsum(keep) - 1
    held = np.array([np.isin(np.flatnonzero(keep), m) for m in carried.members])
    regions = Regions(carried.labels[keep], mesh, held=held, samples=new[samples])
    return mesh, new[samples], regions


def reach(x, mesh, v, areas):
    """Mean distance from the pin at which the face moves, by size of motion and by area, mm."""
    moved = np.linalg.norm(x, axis=1) * areas
    return moved @ np.linalg.norm(mesh.vertices - mesh.vertices[v], axis=1) / moved.sum()


def vertex_areas(mesh):
    return np.bincount(mesh.faces.ravel(), np.repeat(mesh.face_areas / 3, 3), mesh.n_vertices)


def test_a_holistic_model_of_an_uneven_mesh_counts_by_area_in_a_session(rng):
    V = np.array([[x, y, 0.0] for x in np.geomspace(1, 100, 25) for y in range(0, 100, 5)])
    mesh = delaunay(V)
    model = HolisticModel(4).fit(rng.normal(size=(30, 1500)))
    session = PosingSession(model, mesh)
    pull(session, 250, [3.0, 0, 0])
    B, area = model.components_[0], np.repeat(vertex_areas(mesh), 3)
    area = np.maximum(area, area.mean() / 100)
    W = (B * area * 397 / (area.sum() / 3)) @ B.T
    J = B[:, 750:753].T
    c = np.linalg.solve(J.T @ J + 0.025 * W, J.T @ [3.0, 0, 0])
    np.testing.assert_allclose((session.vertices - V).ravel(), c @ B, atol=1e-10)


# --- real motion ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def face(real_rig, real_takes):
    return control_face(real_rig, real_takes["alex_rom_3"])


@pytest.mark.real
def test_pulling_a_mouth_corner_moves_the_mouth_and_not_the_eyes(face):
    v = face.mesh.landmarks["mouth_corner_left"]
    lids = [face.mesh.landmarks[name] for name in LIDS]
    far = np.linalg.norm(face.mesh.vertices - face.mesh.vertices[v], axis=1) > 40
    shares = []
    for model in models(face, 20):
        session = PosingSession(model, face.mesh, beta=0.5, gamma=0.025)
        pull(session, v, 8 * np.array([0.6, 0.8, 0]))
        moved = np.linalg.norm(session.vertices - face.mesh.vertices, axis=1)
        shares.append(np.sum(moved[far] ** 2) / np.sum(moved**2))
        if isinstance(model, RegionModel) and model.regions is not None:
            assert moved[v] >= 5
            assert moved[lids].max() <= 0.5
    assert shares[0] < shares[1]


@pytest.fixture(scope="module")
def densities(face, real_rig, real_takes):
    """Models of the same motion on 397, about 1,500 and all 6,706 vertices."""
    take = real_takes["alex_rom_3"].resampled(15)[::4]
    fine_samples, fine = real_rig.neutral.subsample(1500, keep=face.samples.tolist())
    found = {397: (face.mesh, face.regions, np.arange(397), face.samples)}
    at = np.searchsorted(fine_samples, face.samples)
    found[1500] = (fine, face.regions.carried_to(fine, at), at, fine_samples)
    found[6706] = (
        real_rig.neutral,
        face.regions.carried_to(real_rig.neutral, face.samples),
        face.samples,
        np.arange(6706),
    )
    return {
        n: (mesh, RegionModel(cut, 20).fit(real_rig.on(on, mesh).animate(take).displacements()), at)
        for n, (mesh, cut, at, on) in found.items()
    }


def answers(densities, n, beta, gamma, pins):
    """For pins on control vertices: how far each follows of 8 mm, and how far the motion reaches.

    Each is pulled along the direction in which the model on 397 vertices lets it move most.
    """
    mesh, model, at = densities[n]
    solver, coarse = PoseSolver(model, beta, gamma), PoseSolver(densities[397][1], beta, gamma)
    areas, found = vertex_areas(mesh), []
    for v in pins:
        target = 8 * np.linalg.svd(coarse.rows(int(v)))[0][:, 0]
        x = solver.displacements(solver.solve({int(at[v]): target}))[0]
        found.append((np.linalg.norm(x[at[v]]) / 8, reach(x, mesh, at[v], areas)))
    return np.array(found)


@pytest.mark.real
@pytest.mark.parametrize("n", [1500, 6706])
@pytest.mark.parametrize(
    ("beta", "gamma"), [(0.5, 0.025), (0, 0.025), (2, 0.025), (0.5, 0.005), (0.5, 0.1)]
)
def test_pins_where_a_face_moves_are_answered_alike_at_every_density(
    densities, face, n, beta, gamma
):
    pins = [face.mesh.landmarks[name] for name in PULLED]
    coarse, dense = (answers(densities, m, beta, gamma, pins) for m in (397, n))
    np.testing.assert_allclose(dense, coarse, rtol=0.1)  # the promise: within 10 %


@pytest.mark.real
@pytest.mark.parametrize("n", [1500, 6706])
def test_nine_pins_in_ten_are_answered_alike_at_every_density(densities, n):
    pins = range(0, 397, 4)
    coarse, dense = (answers(densities, m, 0.5, 0.025, pins) for m in (397, n))
    change = dense / coarse - 1
    assert (np.abs(np.median(change, axis=0)) < 0.05).all()
    # two samplings of about 397 vertices differ by more than 10 % in up to one pin in ten
    assert (np.mean(np.abs(change) < 0.1, axis=0) > 0.85).all()
