"""What the page computes by itself, against what the kernel computes."""

from pathlib import Path

import numpy as np
import pytest
from browser_lab import new_page

import facelab.widgets.hand as hand
from facelab.numeric.least_squares import solve_bounded

MATH = Path(hand.__file__).parent / "hand_math.js"
SOLVE = """([M, lo, hi, give, free, side]) => {
  const told = { M: Float64Array.from(M.flat()), lo, hi, give };
  const at = Int8Array.from(side);
  return [[...solveWithin(told, Float64Array.from(free), at)], [...at]]; }"""


@pytest.fixture(scope="module")
def page():
    page = new_page()
    page.add_script_tag(path=MATH)
    yield page
    page.close()


def problem(rng, n):
    J = rng.normal(size=(2 * n, n)) * np.exp(rng.normal(size=n))
    A = J.T @ J + 0.01 * np.eye(n)
    return A, np.linalg.inv(A), 3 * rng.normal(size=n)


@pytest.mark.parametrize("n", [1, 5, 57])
def test_weights_within_ends_are_those_of_the_kernel_s_solver(page, rng, n):
    for _ in range(5):
        A, M, free = problem(rng, n)
        lo, hi = -rng.random(n), rng.random(n)
        hi[n // 2] = lo[n // 2]  # one that is held
        side = rng.integers(-1, 2, n)  # wherever the last solve ended
        told = [M.tolist(), lo.tolist(), hi.tolist(), [0] * n, free.tolist(), side.tolist()]
        found, at = page.evaluate(SOLVE, told)
        expected, _ = solve_bounded(A, A @ free, lo, hi)
        np.testing.assert_allclose(found, expected, atol=1e-7)
        again, _ = page.evaluate(SOLVE, [*told[:-1], at])
        np.testing.assert_allclose(again, expected, atol=1e-7)


def test_coefficients_that_give_beyond_their_ends_are_where_no_force_is_left(page, rng):
    for n in (3, 80):
        A, M, free = problem(rng, n)
        lo, hi, give = -0.2 * np.ones(n), 0.3 * np.ones(n), np.exp(rng.normal(size=n))
        told = [M.tolist(), lo.tolist(), hi.tolist(), give.tolist(), free.tolist(), [0] * n]
        y = np.array(page.evaluate(SOLVE, told)[0])
        beyond = y - y.clip(lo, hi)
        assert np.abs(beyond).max() > 0.1
        force = A @ (y - free) + beyond / give
        np.testing.assert_allclose(force, 0, atol=1e-6 * np.abs(A @ free).max())


def test_a_ray_finds_the_first_triangle_and_normals_are_the_mesh_s(page, grid, rng):
    bent = grid.vertices + np.sin(grid.vertices[:, [1, 0, 0]] / 15) * [0, 0, 4]
    mesh = grid.with_vertices(bent)
    n = mesh.n_vertices
    X, F = bent.ravel().tolist(), mesh.faces.ravel().tolist()
    N = page.evaluate(
        "([X, F, n]) => { const N = new Float64Array(3 * n);"
        "normalsOf(X, F, F.length / 3, n, N); return [...N]; }",
        [X, F, n],
    )
    np.testing.assert_allclose(np.reshape(N, (n, 3)), mesh.normals, atol=1e-12)
    shares = rng.dirichlet(np.ones(3), len(mesh.faces))
    points = (bent[mesh.faces] * shares[..., None]).sum(axis=1)
    for f in range(0, len(points), 17):
        eye = points[f] + [0.0, 0, 90]
        hit = page.evaluate(
            "([o, d, X, F]) => firstHit(o, d, X, F, F.length / 3)", [eye.tolist(), [0, 0, -2], X, F]
        )
        assert hit["face"] == f and hit["t"] == pytest.approx(45)
    away = [[0.0, 0, 90], [0, 0, 1], X, F]
    assert page.evaluate("([o, d, X, F]) => firstHit(o, d, X, F, F.length / 3)", away) is None


def test_no_ray_slips_through_between_triangles_that_share_an_edge_or_a_corner(page, grid, rng):
    bent = grid.vertices + np.sin(grid.vertices[:, [1, 0, 0]] / 15) * [0, 0, 4]
    ends = np.concatenate([grid.faces[:, [a, a - 1]] for a in range(3)])
    ends, seen = np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)
    ends = ends[seen == 2]
    shares = rng.random((len(ends), 1))
    shares[::5] = 0  # a corner
    points = bent[ends[:, 0]] * (1 - shares) + bent[ends[:, 1]] * shares
    X, F = bent.ravel().tolist(), grid.faces.ravel().tolist()
    eye = [1.1, -3.7, 83.3]
    missed = page.evaluate(
        "([o, ways, X, F]) => ways.filter((d) => !firstHit(o, d, X, F, F.length / 3)).length",
        [eye, (points - eye).tolist(), X, F],
    )
    assert missed == 0
