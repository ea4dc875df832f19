"""Second roads for mathematics that a changed line once went through unseen."""

import numpy as np
import pytest
from shapes import sphere_mesh
from sklearn.cluster import KMeans
from sklearn.metrics import adjusted_rand_score
from sklearn.utils import check_random_state

from facelab import HolisticModel, MotionSequence, RegionModel
from facelab.expression import regress_expression
from facelab.models.blending import BLEND_REACH, GradientBlend
from facelab.posing.solver import PoseSolver
from facelab.rig import BlendshapeRig
from facelab.segmentation import Affinity, Regions


@pytest.fixture(scope="module")
def ball():
    return sphere_mesh(3, radius=60.0)


def test_the_cut_of_a_face_is_k_means_on_rows_of_length_one(ball):
    """Not only `spectral_embedding`: the way that growth takes has the scaling of its own."""
    rng = np.random.default_rng(0)
    near = np.exp(-ball.geodesics() / np.where(ball.vertices[:, :1] > 0, 15, 60))
    own = near @ rng.normal(size=(60, ball.n_vertices, 3))  # two kinds of skin: stiff and soft
    affinity = Affinity.of(MotionSequence(ball.vertices + own, 15, ball), threshold=0.4)
    A = affinity.A.copy()
    np.fill_diagonal(A, 0)
    D = np.diag(A.sum(axis=1) ** -0.5)
    X = np.linalg.eigh(D @ A @ D)[1][:, -9:]
    scaled = X / np.linalg.norm(X, axis=1, keepdims=True)
    ours = affinity.segment(9, random_state=0, progress=False).labels
    seed = int(check_random_state(0).randint(2**31 - 1))
    order = scaled[:, ::-1] * np.sign(X[np.abs(X).argmax(axis=0), np.arange(9)])[::-1]
    theirs = KMeans(9, n_init=20, random_state=seed).fit_predict(order)
    bare = KMeans(9, n_init=20, random_state=seed).fit_predict(X[:, ::-1])
    assert adjusted_rand_score(ours, theirs) == 1
    assert adjusted_rand_score(bare, theirs) < 0.9  # or the test could not tell


def test_the_gradient_blend_makes_its_energy_smallest(ball):
    labels = (ball.vertices[:, 0] > 0).astype(int)
    members = Regions(labels, ball, "both").members
    copies = np.random.default_rng(1).normal(size=(sum(map(len, members)), 1))
    starts = np.cumsum([0, *map(len, members)])
    own = [dict(zip(m, copies[s:, 0], strict=False)) for m, s in zip(members, starts, strict=False)]
    n, L = ball.n_vertices, ball.laplacian("cotangent", normalised=False).toarray()
    S, rhs = np.zeros((n, n)), np.zeros(n)
    for v in range(n):
        anchor = ball.vertex_areas[v] / BLEND_REACH**2
        S[v, v] += anchor
        rhs[v] += anchor * np.mean([c[v] for c in own if v in c])
    for a, b in ball.edges:
        wanted = [c[a] - c[b] for c in own if a in c and b in c]
        w = max(-L[a, b], 0)
        S[a, a], S[b, b] = S[a, a] + w, S[b, b] + w
        S[a, b], S[b, a] = S[a, b] - w, S[b, a] - w
        rhs[a], rhs[b] = rhs[a] + w * np.mean(wanted), rhs[b] - w * np.mean(wanted)
    found = GradientBlend(ball, members).carry(copies)[:, 0]
    np.testing.assert_allclose(found, np.linalg.solve(S, rhs), atol=1e-8)
    assert BLEND_REACH == 20.0  # as notebook 04 has it


def test_gamma_of_given_bases_is_scaled_by_their_mean_square(ball):
    regions = Regions((ball.vertices[:, 0] > 0).astype(int), ball)
    shapes = np.random.default_rng(2).normal(size=(4, ball.n_vertices, 3))
    shapes *= np.array([1, 1, 1, 9])[:, None, None]  # mean and largest far apart
    model = RegionModel.from_bases(regions, np.zeros(3 * ball.n_vertices), shapes)
    squares = [(shapes[k, m] ** 2).sum() for m in regions.members for k in range(4)]
    W = model.resistance(np.full(ball.n_vertices, 0.5))
    np.testing.assert_allclose(W, 0.5 * np.mean(squares) * np.eye(8), rtol=1e-10)
    rig = BlendshapeRig(ball, "abcd", shapes)
    W = rig.resistance(np.full(ball.n_vertices, 0.5))
    np.testing.assert_allclose(W, 0.5 * (shapes**2).sum() / 4 * np.eye(4), rtol=1e-6)


def test_a_limited_pull_reaches_two_limits_in_deviations_of_the_vertex(ball):
    rng = np.random.default_rng(3)
    X = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 3 * ball.n_vertices))
    model = HolisticModel(3).fit(X)
    solver = PoseSolver(model, limit=2.0, mesh=ball)
    centre, radius = solver.reach(17)
    own = X[:, 51:54]
    # three modes hold these frames exactly: deviations are those of the vertex itself
    np.testing.assert_allclose(centre, own.mean(axis=0), atol=1e-8)
    assert radius == pytest.approx(4 * np.sqrt(own.var(axis=0, ddof=1).sum()), rel=0.02)


def test_units_cancel_only_where_they_move_a_tenth_of_a_millimetre(ball):
    """Two bumps that undo each other; what moves nobody could see counts for nothing."""
    bump = np.exp(-ball.geodesics([40])[0] / 15)
    deltas = np.zeros((2, ball.n_vertices, 3))
    deltas[0, :, 2], deltas[1, :, 2] = bump, -bump
    deltas[1, :, 0] = 0.2 * bump  # or one would follow from the other
    rig = BlendshapeRig(ball, ("up", "down"), deltas)
    for weight, pairs in ((0.07, []), (0.13, [("up", "down")])):
        locked = {"up": weight, "down": weight}
        fit = regress_expression(rig, ball, 0, [0], locked=locked)
        assert fit.cancelling(0) == pairs
