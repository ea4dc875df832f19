"""What posing allows: within it the answer is sound; what is refused leaves no trace."""

from fractions import Fraction

import numpy as np
import pytest
from planted import bumps, corner_regions, quarters

from facelab.models.region import RegionModel
from facelab.posing import ranges
from facelab.posing.log import replay
from facelab.posing.session import PosingSession
from facelab.posing.solver import PoseSolver
from facelab.rig import BlendshapeRig
from facelab.segmentation.regions import Regions


@pytest.fixture(scope="module")
def model():
    """A region model with modes that no boundary sees: Eq. 10 is as ill as beta / gamma."""
    mesh, labels = quarters(8, 7)
    return RegionModel(Regions(labels, mesh), 6).fit(bumps(mesh, labels, np.random.default_rng(1)))


@pytest.fixture
def session(model):
    return PosingSession(model, model.regions.mesh)


@pytest.fixture
def rigged(rng):
    mesh = corner_regions().mesh
    rig = BlendshapeRig(mesh, "abcd", rng.normal(size=(4, 42, 3)))
    return PosingSession(rig, mesh)


def exactly(A, b):
    """A^-1 b in fractions."""
    rows = [[Fraction(x) for x in (*row, y)] for row, y in zip(A.tolist(), b.tolist(), strict=True)]
    for i in range(len(rows)):
        pivot = max(range(i, len(rows)), key=lambda r: abs(rows[r][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for r in range(len(rows)):
            if r != i and rows[r][i]:
                share = rows[r][i] / rows[i][i]
                rows[r] = [x - share * y for x, y in zip(rows[r], rows[i], strict=True)]
    return np.array([float(row[-1] / row[i]) for i, row in enumerate(rows)])


@pytest.mark.parametrize(
    ("beta", "gamma", "weight"), [(0.5, 0.025, 1), (1e5, 1e-6, 1), (0.5, 1e-3, 1e6), (1e3, 1e-8, 1)]
)
def test_what_is_allowed_is_right_to_a_hundredth_of_a_millimetre(model, beta, gamma, weight):
    solver = PoseSolver(model, beta, gamma)
    targets = np.array([[3.0, 1, 0], [0, 0, 5]])
    found = solver.problem([3, 30], [weight, 1]).solve(targets, *np.zeros((2, 24)))
    J = np.concatenate([np.sqrt(weight) * solver.rows(3), solver.rows(30)])
    pulls = np.column_stack([weight * solver.pin(3)[1], solver.pin(30)[1]])
    A = solver.at_rest + J.T @ J
    assert np.linalg.cond(A, 1) < ranges.CONDITION
    off = solver.displacements(found - exactly(A, pulls @ targets.ravel()))
    assert np.abs(off).max() < 0.01


@pytest.mark.parametrize(
    "settings",
    [
        *({"beta": x} for x in (-1e-9, 1.1e6, 1e308, np.inf, np.nan)),
        *({"gamma": x} for x in (0, 0.9e-9, 1.1e9, 1e308, np.inf, np.nan)),
        *({"limit": x} for x in (0, 0.009, 1001, 1e308, np.inf, np.nan)),
        {"beta": 1e6, "gamma": 1e-9},
    ],
    ids=str,
)
def test_settings_outside_their_range_or_too_far_apart_are_refused(session, model, settings):
    before = vars(session.history).copy()
    message = "lie too far apart: the condition number" if len(settings) == 2 else "but it must be"
    with pytest.raises(ValueError, match=message):
        session.set(**settings)
    assert vars(session.history) == before
    with pytest.raises(ValueError, match=message):
        fresh = PosingSession(model, model.regions.mesh, **settings)
        fresh.press(3)


@pytest.mark.parametrize("kind", ["session", "rigged"])
@pytest.mark.parametrize("weight", [0, 0.9e-6, 1.1e6, 1e300, np.inf, "1", True])
def test_weights_outside_their_range_are_refused(request, kind, weight):
    session = request.getfixturevalue(kind)
    with pytest.raises((ValueError, TypeError), match="weight="):
        session.set_pin(3, weight=weight)
    assert session.n_undo == 0


def test_a_rig_is_solved_soundly_too(rigged):
    rigged.set_pin(3, rigged.vertices[3] + [9.0, 9, 9], weight=1e6)
    with pytest.raises(ValueError, match=r"gamma=1e-09 and weights from 1e\+06 to 1e\+06 lie too"):
        rigged.set(gamma=1e-9)
    assert rigged.n_undo == 1


def test_the_limit_says_what_is_wrong_with_infinity(session):
    with pytest.raises(ValueError, match=r"limit=inf, but it must be finite and 0\.01 or more"):
        session.set(limit=np.inf)


@pytest.mark.parametrize(
    "action",
    [
        lambda s: s.apply([1e308] * 24),
        lambda s: s.mold(0, 0, 1e15),
        lambda s: s.vertices_of(np.full(24, 1e308)),
        lambda s: s.drag(3, [1e308, 0, 0]),
        lambda s: s.pull(3, [0, -1e11, 0]),
        lambda s: s.set_pin(3, [1e308, 0, 0]),
    ],
)
def test_poses_beyond_any_face_are_refused(session, action, recwarn):
    with pytest.raises(ValueError, match="are allowed"):
        action(session)
    assert session.n_undo == 0 and not session.dragging and not recwarn.list


@pytest.mark.parametrize("symmetric", [False, True])
def test_a_press_is_still_there_after_an_edit_was_refused(session, symmetric):
    session.symmetric = symmetric
    session.set_pin(3)
    session.press(20)
    before = vars(session.history).copy()
    for edit in (session.mirror_pin, session.remove_pin):
        with pytest.raises(ValueError, match="vertex=20 is not pinned; pinned are: 3"):
            edit(20)
        assert vars(session.history) == before and session.dragging
    session.drag(20, session.vertices[20] + 1)
    session.release()
    session.mirror_pin(20)
    assert replay(session.log, PosingSession(session.model, session.neutral)).log


@pytest.mark.parametrize("value", [np.nan, object(), "no", 2, None, [True]])
def test_what_is_neither_true_nor_false_is_refused(session, value):
    with pytest.raises(ValueError, match="is unknown; choose one of True, False"):
        session.symmetric = value
    if value is not None:
        with pytest.raises(ValueError, match=r"locked=.* is unknown; choose one of True, False"):
            session.set_pin(3, locked=value)
    assert session.n_undo == 0 and session.symmetric is False


@pytest.mark.parametrize("key", [np.nan, 3, b"a", ("a",)])
def test_the_key_of_a_group_is_a_name(session, key):
    with pytest.raises(TypeError, match=r"key is a .*; give a name"), session.group(key):
        session.hold(3)
    assert session.n_undo == 0


@pytest.mark.parametrize("how", ["group", "replay"])
def test_a_group_or_log_that_fails_leaves_the_drag_under_way(session, how):
    session.drag(20, session.vertices[20] + 3)
    before = vars(session.history).copy()
    V = session.vertices
    with pytest.raises(ValueError, match="beta=-1"):
        if how == "replay":
            replay([{"do": "keep"}, {"do": "set", "beta": -1}], session)
        with session.group("slider"):
            session.keep()
            session.set(beta=-1)
    assert vars(session.history) == before
    np.testing.assert_array_equal(session.vertices, V)
    session.release()
    assert session.n_undo == 1


def test_a_stroke_of_a_slider_is_one_entry_of_the_log(session):
    for k in range(1, 301):
        with session.group("mold"):
            session.mold(1, 2, k / 100)
    for k in range(1, 301):
        with session.group("beta"):
            session.set(beta=k / 100)
    assert [(e["do"], e.get("value"), e.get("beta")) for e in session.log] == [
        ("mold", 3.0, None),
        ("set", None, 3.0),
    ]
    again = replay(session.log, PosingSession(session.model, session.neutral))
    np.testing.assert_array_equal(again.vertices, session.vertices)
    assert (again.n_undo, again.log[0]["value"]) == (2, 3.0)
