import warnings

import numpy as np
import pytest
from shapes import sphere_mesh

from facelab.expression import prepare_units, regress_expression
from facelab.expression.session import ALPHAS, BOUNDS, ExpressionSession
from facelab.expression.transfer import IntermediateSpace
from facelab.files.obj import read_obj, write_obj
from facelab.files.poses import load_pose
from facelab.files.takes import read_live_link_csv, read_weights
from facelab.motion import MotionSequence
from facelab.posing.sculpt import Sculpt
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig

LAM = 0.3


def bumps(seed, names=tuple(f"AU{i}" for i in range(8))):
    """Overlapping bumps on a sphere of 162 vertices."""
    rng = np.random.default_rng(seed)
    mesh = sphere_mesh(2, radius=50.0)
    centres = mesh.vertices[rng.permutation(mesh.n_vertices)[: len(names)]]
    near = np.exp(-((np.linalg.norm(mesh.vertices - centres[:, None], axis=2) / 35) ** 2))
    return BlendshapeRig(
        mesh, names, near[..., None] * rng.normal(scale=6, size=(len(names), 1, 3))
    )


@pytest.fixture(scope="module")
def basis():
    return prepare_units(bumps(3))


@pytest.fixture
def truth():
    return {"AU1": 0.8, "AU4": 0.35, "AU6": 0.6}


@pytest.fixture
def session(basis, truth, rng):
    V = basis.rig.shape(truth)
    return ExpressionSession(basis, V + rng.normal(scale=0.5, size=V.shape), lam=LAM)


def test_planted_units_are_read_off_an_exact_sketch(basis, truth):
    session = ExpressionSession(basis, basis.rig.shape(truth))
    w = np.array([truth.get(n, 0) for n in session.names])
    # the best alpha is the nearest of a grid of tenths: off by 0.05 at most, times lam's pull
    np.testing.assert_allclose(session.weights, w, atol=0.03)
    assert list(session.named)[:3] == ["AU1", "AU6", "AU4"]
    session.set(alpha=sum(truth.values()))
    np.testing.assert_allclose(session.weights, w, atol=1e-9)
    np.testing.assert_allclose(session.vertices, basis.rig.shape(truth), atol=1e-8)
    assert session.rms < 1e-8


def test_a_new_session_is_at_rest(basis):
    session = ExpressionSession(basis)
    assert (session.state.origin, session.alpha, session.named) == ("neutral", 0, {})
    np.testing.assert_array_equal(session.vertices, basis.rig.neutral.vertices)
    assert not session.can_undo and not session.undo() and not session.redo()


@pytest.mark.parametrize("bounds", BOUNDS)
@pytest.mark.parametrize("alpha", [0, 1.23, 4.0, 77.7])
def test_any_alpha_of_the_path_is_the_regression_at_that_alpha(session, bounds, alpha):
    session.set(alpha=alpha, bounds=bounds)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # 77.7 is out of reach within [0, 1]
        fit = regress_expression(session.basis, session.sketch, LAM, [alpha], BOUNDS[bounds])
    np.testing.assert_allclose(session.weights, fit.weights[0], atol=1e-9)
    np.testing.assert_allclose(session.vertices, fit.vertices(0), atol=1e-8)
    assert session.rms == pytest.approx(fit.rms[0], abs=1e-9)


def test_moving_alpha_solves_nothing(session, monkeypatch):
    monkeypatch.setattr("facelab.expression.session.regress_expression", None)
    for alpha in (0, 3.3, 50, "best"):
        session.set(alpha=alpha)
    with pytest.raises(TypeError):  # so that the test would notice
        session.set(lam=2.0)


def test_the_best_alpha_is_followed_until_one_is_chosen(session, truth):
    assert session.state.alpha is None
    assert session.alpha == session.best_alpha == ALPHAS[session.fit.rms.argmin()]
    session.exclude("AU1")
    assert session.alpha == session.best_alpha
    session.set(alpha=5)
    session.free()
    assert session.alpha == 5 and abs(session.best_alpha - sum(truth.values())) < 0.3
    session.set(alpha="best")
    assert session.alpha == session.best_alpha


def test_a_locked_weight_stays_and_the_others_take_the_rest(session, truth):
    session.lock("AU1", 0.25)
    for alpha in (0, 2, 8, "best"):
        session.set(alpha=alpha)
        assert session.weights[1] == 0.25
    locked = {"AU1": 0.25}
    fit = regress_expression(session.basis, session.sketch, LAM, ALPHAS, (0, 1), locked=locked)
    np.testing.assert_allclose(session.weights, fit.weights[fit.best], atol=1e-9)
    session.free("AU1")
    assert session.weights[1] == pytest.approx(truth["AU1"], abs=0.1)


def test_locking_without_a_number_holds_the_present_weight(session):
    w = session.weights[4]
    session.lock("AU4")
    session.set(alpha=7)
    assert session.weights[4] == w and session.state.locked == {"AU4": w}


def test_an_excluded_unit_is_zero_and_a_lock_takes_its_place(session):
    session.lock("AU1", 0.5)
    session.exclude("AU1")
    session.set(alpha=6)
    assert session.weights[1] == 0 and not session.state.locked
    session.lock("AU1", 0.7)
    assert session.weights[1] == 0.7 and not session.state.excluded
    session.exclude("AU2")
    session.free()
    assert not session.state.locked and not session.state.excluded


def test_undo_and_redo_return_to_every_step_exactly(session, basis, rng):
    seen = [session.weights]
    for act in (
        lambda: session.set(alpha=4),
        lambda: session.lock("AU2", 0.5),
        lambda: session.set(lam=2.0),
        lambda: session.exclude("AU6"),
        lambda: session.set(bounds="free"),
        lambda: session.load(basis.rig.shape({"AU3": 0.5})),
        lambda: session.set(criterion="gcv", alpha="best"),
    ):
        act()
        seen.append(session.weights)
    for w in seen[-2::-1]:
        assert session.undo()
        np.testing.assert_array_equal(session.weights, w)
    assert not session.can_undo
    for w in seen[1:]:
        assert session.redo()
        np.testing.assert_array_equal(session.weights, w)
    session.undo()
    session.set(alpha=1)
    assert not session.can_redo


@pytest.mark.parametrize(
    "change",
    [
        lambda s, k: s.set(alpha=k / 10),
        lambda s, k: s.set(lam=1 + k / 10),
        lambda s, k: s.lock("AU5", k / 30),
        lambda s, k: s.load(s.rig.shape({"AU5": k / 30}), live=True),
    ],
)
def test_a_run_of_moves_is_one_step_and_settling_ends_it(session, change):
    start = session.weights
    for k in range(1, 10):
        change(session, k)
    first = session.weights
    session.settle()
    for k in range(10, 20):
        change(session, k)
    session.undo()
    np.testing.assert_array_equal(session.weights, first)
    session.undo()
    np.testing.assert_array_equal(session.weights, start)
    assert not session.can_undo


def test_setting_what_is_set_is_no_step(session):
    session.set(alpha="best", lam=LAM, bounds="0 to 1", criterion="e_rms", align="check")
    assert not session.can_undo


def test_an_alpha_out_of_reach_is_said(session):
    session.set(alpha=5)
    assert session.note == ""
    session.set(alpha=9)
    assert "α = 9 cannot be reached: the weights sum to at most 8 here" in session.note
    session.set(bounds="not negative")
    assert session.note == ""
    session.set(bounds="0 to 1", alpha=0)
    session.lock("AU3", 0.5)
    assert "at least 0.5" in session.note


def test_with_every_unit_locked_the_session_still_answers(session):
    for name in session.names:
        session.lock(name, 0.33)
    np.testing.assert_array_equal(session.weights, np.full(8, 0.33))
    assert session.reach == pytest.approx((2.64, 2.64)) and session.note


def test_a_boundary_is_reported_and_kept_if_asked_for(session, basis):
    session.load(basis.rig.shape(np.ones(8)))
    over = session.excess
    assert over.max() > 1
    free = session.vertices
    session.set(clamp=True)
    moved = np.linalg.norm(session.vertices - basis.rig.neutral.vertices, axis=1)
    assert (moved <= basis.limit + 1e-9).all()
    np.testing.assert_allclose(session.vertices[over == 0], free[over == 0], atol=1e-12)


def test_a_turned_sketch_is_refused_and_aligned_on_demand(session, basis, truth):
    turn = np.array([[0.96, -0.28, 0], [0.28, 0.96, 0], [0, 0, 1]])
    turned = basis.rig.shape(truth) @ turn.T + [0, 30, 0]
    with pytest.raises(ValueError, match="sketch is not aligned"):
        session.load(turned)
    session.set(align=True)
    session.load(turned)
    session.set(alpha=sum(truth.values()))
    assert session.named == pytest.approx(truth, abs=1e-6)
    np.testing.assert_allclose(session.sketch, basis.rig.shape(truth), atol=1e-6)
    with pytest.raises(ValueError, match="sketch is not aligned"):
        session.set(align="check")
    assert session.state.align is True


def test_sketches_come_from_a_file_a_frame_and_a_hand(session, basis, truth, tmp_path):
    V = basis.rig.shape(truth)
    write_obj(tmp_path / "cm.obj", basis.rig.neutral.with_vertices(V / 10))
    session.load_file(tmp_path / "cm.obj", scale=10)
    assert session.state.origin.endswith("cm.obj")
    # nine digits in the file
    np.testing.assert_allclose(session.sketch, V, atol=1e-6)
    positions = np.stack([basis.rig.neutral.vertices, V, V]).astype(np.float32)
    motion = MotionSequence(positions, 30, basis.rig.neutral, np.array([True, True, False]))
    session.load_frame(motion, 1)
    assert session.state.origin == "frame 1"
    np.testing.assert_allclose(session.sketch, V, atol=1e-4)
    sculpt = Sculpt(basis.rig.neutral, session.sketch)
    sculpt.drag(5, sculpt.vertices[5] + [0, 0, 3])
    session.load(sculpt.vertices, "pulled by hand")
    np.testing.assert_allclose(session.sketch[5], V[5] + [0, 0, 3], atol=1e-4)


def test_the_sketch_is_a_copy(session, basis):
    V = basis.rig.shape({"AU2": 0.5})
    session.load(V)
    V += 100
    assert np.abs(session.sketch - V).min() > 50


def test_the_expression_goes_to_another_face_with_the_same_units(session):
    session.set(bounds="free", alpha=2)
    other = bumps(4, (*reversed(session.names), "AU99"))
    on_other = session.on(other)
    expected = other.neutral.vertices + sum(
        w * other.deltas[other.names.index(n)]
        for n, w in zip(session.names, session.weights, strict=True)
    )
    np.testing.assert_allclose(on_other, expected, atol=1e-3)  # weights below 1e-6 are left
    with pytest.raises(ValueError, match="face lacks AU1, "):
        session.on(bumps(4, ("AU0", "AU99")))


def test_the_weights_leave_as_a_take_of_one_frame(session):
    take = session.take()
    assert (take.names, take.n_frames) == (session.names, 1)
    np.testing.assert_array_equal(take.weights[0], session.weights)


def test_the_result_is_saved_as_the_end_of_the_name_says(basis, truth, tmp_path):
    names = ["AU12L", "AU1", "AU35", "AU45L", "AU9", "AU17", "AU26", "AU4"]
    rig = BlendshapeRig(basis.rig.neutral, names, basis.rig.deltas)
    session = ExpressionSession(rig, rig.shape([0.5, 0, 0.3, 0, 0.25, 0, 0, 0]))
    session.set(alpha=1.05)
    assert session.save(tmp_path / "w.csv") == ""
    table = read_weights(tmp_path / "w.csv")
    np.testing.assert_array_equal(table.weights[0], session.weights)
    assert "AU35" in session.save(tmp_path / "w.livelink.csv")
    live = read_live_link_csv(tmp_path / "w.livelink.csv")
    named = {n: w for n, w in zip(live.names, live.weights[0], strict=True) if w > 1e-6}
    expected = {"mouthSmileLeft": 0.5, "noseSneerLeft": 0.25, "noseSneerRight": 0.25}
    assert named == pytest.approx(expected, abs=1e-6)
    session.save(tmp_path / "face.obj")
    np.testing.assert_allclose(
        read_obj(tmp_path / "face.obj").vertices, session.vertices, atol=1e-6
    )
    session.save(tmp_path / "pose.json")
    posing = PosingSession(rig, rig.neutral)
    load_pose(tmp_path / "pose.json", posing)
    np.testing.assert_allclose(posing.vertices, session.vertices, atol=1e-9)
    with pytest.raises(ValueError, match=r"w.xls.*end it in .csv, .livelink.csv, .json or .obj"):
        session.save(tmp_path / "w.xls")
    assert len(list(tmp_path.iterdir())) == 4


def test_the_expression_goes_to_a_mesh_of_another_place_through_an_intermediate_space(session):
    other = session.rig.neutral.with_vertices(1.1 * session.rig.neutral.vertices)
    space = IntermediateSpace(session.rig, other, method="copy")
    moved = session.vertices - session.rig.neutral.vertices
    np.testing.assert_allclose(session.on(space), other.vertices + moved, atol=1e-4)


@pytest.mark.parametrize(
    "act, error, complaint",
    [
        (lambda s: s.load(np.full((162, 3), np.nan)), ValueError, "sketch holds 486 value"),
        (lambda s: s.load(np.zeros((7, 3))), ValueError, r"sketch has shape \(7, 3\)"),
        (lambda s: s.load(s.sketch / 10), ValueError, "times the size"),
        (lambda s: s.set(lam=1e6), ValueError, r"lam=1000000.0, but .* 1000.0 or less"),
        (lambda s: s.load("abc"), TypeError, r"sketch is a str.*shape \(n_vertices, 3\)"),
        (lambda s: s.load(s), TypeError, "sketch is a ExpressionSession"),
        (lambda s: s.on(s.sketch), TypeError, "face is a ndarray.*BlendshapeRig or Intermediate"),
        (lambda s: s.load_file("nowhere.obj"), FileNotFoundError, "no such OBJ"),
        (lambda s: s.load_frame(s.sketch, 0), TypeError, "motion is a ndarray"),
        (lambda s: s.set(alpha=101), ValueError, "alpha=101"),
        (lambda s: s.set(alpha="good"), ValueError, "alpha='good'"),
        (lambda s: s.set(lam=-1), ValueError, "lam=-1"),
        (lambda s: s.set(bounds="none"), ValueError, "bounds='none'"),
        (lambda s: s.set(criterion="eye"), ValueError, "criterion='eye'"),
        (lambda s: s.set(align="maybe"), ValueError, "align='maybe'"),
        (lambda s: s.lock("AU77"), ValueError, "name='AU77' is no unit here"),
        (lambda s: s.lock("AU1", np.inf), ValueError, "weight=inf"),
        (lambda s: s.exclude("AU77"), ValueError, "name='AU77'"),
        (lambda s: s.free("AU2"), ValueError, "neither locked nor excluded"),
    ],
)
def test_an_error_is_clear_and_the_last_good_state_stays(session, act, error, complaint):
    session.set(alpha=3)
    state = session.state
    with pytest.raises(error, match=complaint):
        act(session)
    assert session.state is state


def test_a_lost_or_missing_frame_is_refused(session, basis):
    V = basis.rig.neutral.vertices
    motion = MotionSequence(np.stack([V, V]), 30, basis.rig.neutral, np.array([True, False]))
    with pytest.raises(ValueError, match="frame=1 was lost"):
        session.load_frame(motion, 1)
    with pytest.raises(ValueError, match="frame=2, but there are 2 frames"):
        session.load_frame(motion, 2)


def test_a_unit_that_moves_nothing_cannot_be_locked():
    rig = bumps(3)
    deltas = rig.deltas.copy()
    deltas[2] = 0
    with pytest.warns(UserWarning, match="left out"):
        session = ExpressionSession(BlendshapeRig(rig.neutral, rig.names, deltas))
    with pytest.raises(ValueError, match="AU2' moves nothing of its own"):
        session.lock("AU2", 1)


def test_what_changes_nothing_is_no_step_and_no_news(session):
    news = []
    session.exclude("AU3")
    session.lock("AU1", 0.5)
    session.set(alpha=2)
    session.observe(news.append)
    before = session.state
    session.exclude("AU3")
    session.lock("AU1", 0.5)
    session.set(alpha=2, lam=before.lam)
    session.load(before.sketch, before.origin)
    assert session.state is before and not news
    session.free()
    freed = session.state
    session.free()
    assert session.state is freed and news == ["step"]


def test_those_who_watch_hear_of_every_change_once(session):
    news = []
    session.observe(news.append)
    session.set(alpha=1)
    session.set(alpha=2)
    session.lock("AU1", 0.5)
    session.undo()
    session.redo()
    session.load(session.basis.rig.neutral)
    assert news == ["step"] * 6
    with pytest.raises(ValueError, match="lam=-1"):
        session.set(lam=-1)
    while session.undo():
        pass
    assert len(news) == 6 + 3


def test_a_pose_file_says_what_to_do_about_weights_that_it_cannot_hold(session, tmp_path):
    session.lock("AU1", 1.5)
    with pytest.raises(ValueError, match=r"0 to 1.*choose bounds='0 to 1'.*save as \.csv"):
        session.save(tmp_path / "pose.json")
    assert not list(tmp_path.iterdir())


# --- pins of a sketch pulled by hand --------------------------------------------------------------


@pytest.fixture
def rig(basis):
    return basis.rig


def test_pulls_are_pins_that_are_typed_hidden_named_and_taken_back_in_any_order(rig):
    session, V = ExpressionSession(rig), rig.neutral.vertices
    a, b = 0, rig.neutral.n_vertices // 2
    session.set_pin(a, V[a] + [0, 0, 3.0])
    once = session.sketch
    np.testing.assert_allclose(session.pins[a], V[a] + [0, 0, 3.0], atol=1e-9)
    session.set_pin(b, V[b] + [0, 2.0, 0])
    session.set_pin(a, session.sketch[a] + [1.0, 0, 0])
    assert set(session.pins) == {a, b} and session.state.origin == "pulled by hand"
    session.set_pin(a, hidden=True, name=" tip ")
    assert session.hidden == {a} and session.pin_names == {a: "tip"}
    session.remove_pin(a)
    assert list(session.pins) == [b] and not session.hidden and not session.pin_names
    session.remove_pin(b)
    np.testing.assert_allclose(session.sketch, V, atol=1e-9)
    for _ in range(5):
        session.undo()
    np.testing.assert_array_equal(session.sketch, once)
    session.load(rig.neutral)
    assert not session.pins


def test_a_pull_as_it_is_drawn_is_one_pin_and_one_step(rig):
    session, sculpt = ExpressionSession(rig), Sculpt(rig.neutral)
    for z in (1.0, 2.0, 4.0):
        sculpt.drag(5, rig.neutral.vertices[5] + [0, 0, z])
        session.load(sculpt.vertices, "pulled by hand", live=True, pulled=5)
    session.settle()
    assert session.n_undo == 1
    np.testing.assert_allclose(session.state.pulls[5], [0, 0, 4.0], atol=1e-9)
    session.remove_pin(5)
    np.testing.assert_allclose(session.sketch, rig.neutral.vertices, atol=1e-9)


@pytest.mark.parametrize(
    "bad", [{"vertex": -1}, {"target": [0, 0, np.nan]}, {"hidden": "yes"}, {"name": 3}]
)
def test_what_is_no_pin_of_a_sketch_is_refused_and_nothing_changes(rig, bad):
    session = ExpressionSession(rig)
    with pytest.raises((TypeError, ValueError), match=next(iter(bad))):
        session.set_pin(**{"vertex": 3, **bad})
    with pytest.raises(ValueError, match="no pin"):
        session.remove_pin(3)
    assert not session.can_undo
