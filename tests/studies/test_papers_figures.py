"""What the papers' figures say, as numbers: cuts, spreads, poses; on data with known answers."""

import numpy as np
import pytest
from shapes import sphere_mesh

from facelab import HolisticModel, MotionSequence, RegionModel
from facelab.geometry import mirror_twins
from facelab.models.evaluation import ErrorCurve
from facelab.segmentation import Regions
from facelab.studies import figure5, posing_trials, segmentation_trials


@pytest.fixture(scope="module")
def ball():
    return sphere_mesh(3, radius=60.0)


@pytest.fixture(scope="module")
def motion(ball):
    """Thirteen patches that move by themselves, and the head turned a little."""
    rng = np.random.default_rng(0)
    seeds = np.linspace(0, ball.n_vertices - 1, 13).astype(int)
    patch = ball.nearest_of(seeds)
    signal = rng.normal(scale=2, size=(80, 13, 3))[:, patch]
    noise = rng.normal(scale=0.3, size=(80, ball.n_vertices, 3))
    return MotionSequence(ball.vertices + signal + noise, 15, ball)


def test_both_alignments_give_a_row_each_and_the_paper_s_is_aligned(ball, motion):
    twins = mirror_twins(ball)
    rows = segmentation_trials.cut_both_ways("ball", motion, twins, max_regions=16, n_chance=5)
    assert [r.alignment for r in rows] == list(segmentation_trials.ALIGNMENTS)
    paper, held = rows
    assert paper.symmetry_distance == held.symmetry_distance  # distance knows of no motion
    alone = segmentation_trials.cut_both_ways("ball", motion.aligned(), twins, 16, 5)[1]
    assert paper.like_motion == alone.like_motion and paper.stops == alone.stops
    assert set(held.whole) <= {9, 13, 14} and 2 <= held.stops <= 16
    assert 0 < held.like_motion <= 1 and held.symmetry_chance < 0.8


def test_chance_is_far_from_the_symmetry_of_a_symmetric_cut(ball):
    twins = mirror_twins(ball)
    chance = segmentation_trials.chance_symmetry(ball, twins, 6, 20)
    assert chance.shape == (20,) and 0 < chance.mean() < 0.7
    with pytest.raises(ValueError, match="n_regions"):
        segmentation_trials.chance_symmetry(ball, twins, 1)


def curve(errors, sizes):
    """Two frames of each of two people, with these errors by size."""
    squares = np.array([[a, a, b, b] for a, b in errors], dtype=float) ** 2
    takes = np.array(["A/1", "A/1", "B/1", "B/1"])
    return ErrorCurve(np.array(sizes), np.array(sizes), squares, takes)


def test_spreads_and_added_actors_are_counted_by_hand():
    sizes = (1, 2)
    curves = {
        ("A", "holistic", "frames"): curve([(1.0, 3.0), (1.0, 2.0)], sizes),
        ("A", figure5.REGION, "frames"): curve([(1.0, 2.0), (0.5, 2.0)], sizes),
        ("A+B", "holistic", "frames"): curve([(1.1, 1.5), (1.2, 1.0)], sizes),
        ("A+B", figure5.REGION, "frames"): curve([(1.0, 1.0), (0.6, 2.2)], sizes),
    }
    first, second = figure5.spreads(curves, ["A", "B"], sizes=sizes)
    assert (first.training, first.lower, first.sizes) == ("A", 1, 2)
    # variances 1 and 0.25 without regions, 0.25 and 0.5625 with them
    assert first.ratio == pytest.approx((0.25 + 2.25) / 2)
    assert first.lower_relative == 1 and second.lower == 1
    added, old = figure5.adding(curves, ["A", "B"], sizes=sizes)
    np.testing.assert_allclose(added[0], [[0.5, 0.5], [0.5, 1.1]])
    np.testing.assert_allclose(old[0], [[1.1, 1.2], [1.0, 1.2]])
    assert figure5.error_at(curves, "B", "A", "holistic", 2) == pytest.approx(2.0)


def test_markers_within_the_marks_are_counted():
    X = np.zeros((2, 12))
    X_hat = X.copy()
    X_hat[0, [0, 4]] = 1.4, 1.6  # one vertex off by less than the mark, one by more
    np.testing.assert_allclose(figure5.within_marks(X, X_hat), [0.75, 1.0])


def test_locality_is_of_one_pull_at_a_time_and_scales_with_it(ball, motion):
    regions = Regions(ball.nearest_of(np.linspace(0, 600, 6).astype(int)), ball)
    X = motion.displacements()
    model = RegionModel(regions, 5).fit(X)
    pulls = {10: (0, 0, 6), 300: (0, 6, 0)}
    one, two = (
        posing_trials.locality(model, ball, {v: k * np.array(p) for v, p in pulls.items()})
        for k in (1, 2)
    )
    # poses are affine in the target; the neutral is kept exactly, so twice the pull is twice both
    assert two.followed == pytest.approx(2 * one.followed, rel=1e-6)
    assert two.per_millimetre == pytest.approx(one.per_millimetre, rel=1e-6)
    assert one.parameters == model.n_coefficients
    whole = posing_trials.locality(HolisticModel(5).fit(X), ball, pulls)
    assert one.per_millimetre < whole.per_millimetre
    with pytest.raises(ValueError, match="far=1000"):
        posing_trials.locality(model, ball, pulls, far=1000)


def test_a_face_is_sculpted_pull_after_pull(ball, motion):
    model = HolisticModel(20).fit(motion.displacements())
    found = posing_trials.sculpt(model, ball, {10: (0, 0, 6), 300: (0, 6, 0)}, gamma=1e-6)
    assert found.vertices == (10, 300) and found.poses.shape == (2, ball.n_vertices, 3)
    after_one, after_two = np.linalg.norm(found.poses[:, 10] - found.targets[0], axis=1)
    assert after_one < 0.1 and after_two < 0.1  # the first pin holds while the second is pulled
    assert np.linalg.norm(found.poses[1, 300] - found.targets[1]) < 0.1
    assert np.linalg.norm(found.poses[0, 300] - found.targets[1]) > 1


class Teacher:
    """What the grid asks of an actor: motion and the truth behind it, three planted waves."""

    def __init__(self, ball, seed):
        rng = np.random.default_rng(seed)
        waves = np.sin(ball.vertices / 20)[None] * np.array([1, 2, 3])[:, None, None]
        self.skin = np.tensordot(rng.normal(size=(60, 3)), waves**3, axes=1)
        self.noise = rng.normal(scale=0.1, size=self.skin.shape)
        self.ball = ball

    def motion(self, kind=None):
        return MotionSequence(self.ball.vertices + self.skin + self.noise, 15, self.ball)

    def truth(self, kind):
        return MotionSequence(self.ball.vertices + self.skin, 15, self.ball)


def test_an_error_grid_has_each_model_at_its_place(ball):
    actors = {"A": Teacher(ball, 0), "B": Teacher(ball, 1)}
    grid = figure5.error_grid(actors, counts=(2, 4), sizes=(1, 3))
    assert grid.region.shape == grid.as_many.shape == (2, 2, 2)
    assert grid.holistic.shape == (2, 2) and (grid.counts, grid.sizes) == ((2, 4), (1, 3))
    X = actors["A"].motion().displacements()
    wanted = actors["B"].truth("test").displacements()
    regions = figure5.face_regions(actors["A"], 4)
    made = RegionModel(regions, 3).fit(X).reconstruct(actors["B"].motion().displacements())
    by_hand = np.sqrt(3 * ((made - wanted) ** 2).mean())
    assert grid.region[1, 1, 1] == pytest.approx(by_hand, rel=1e-6)
    frames = figure5.error_grid(actors, (2,), (1,), "frames")
    assert frames.region[0, 0, 0] > grid.region[0, 0, 0]  # the noise is not rebuilt
