"""Faults of captured markers are counted as they were planted."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facelab.geometry import TriangleMesh
from facelab.studies import captures


def test_the_motion_of_the_head_is_undone_exactly(rng):
    still = rng.normal(size=(5, 7, 3))
    R, t = Rotation.random(5, random_state=1).as_matrix(), rng.normal(size=(5, 3))
    room = still @ np.swapaxes(R, 1, 2) + t[:, None]
    truth = SimpleNamespace(rotation=R, translation=t)
    np.testing.assert_allclose(captures.in_head(room, truth), still, atol=1e-12)


def test_gaps_are_counted_with_those_at_both_ends():
    visible = np.array([[0, 1, 0, 0, 1, 0], [1, 1, 1, 1, 1, 1]], dtype=bool).T
    assert captures.gap_lengths(visible).tolist() == [1, 2, 1]
    assert captures.gap_lengths(visible[:, 1:]).size == 0


def test_a_straight_path_is_bridged_without_error(rng):
    seconds = np.arange(20) / 10
    path = rng.normal(size=(1, 4, 3)) + seconds[:, None, None] * rng.normal(size=(1, 4, 3))
    visible = rng.random((20, 4)) > 0.4
    visible[[0, -1]] = True
    seen = np.where(visible[..., None], path, np.nan)
    np.testing.assert_allclose(captures.bridged(seen, visible, seconds), path, atol=1e-12)


def test_a_curve_that_runs_behind_is_found_late_by_as_many_frames(rng):
    true = rng.normal(size=80).cumsum()
    assert captures.lag(np.roll(true, 3), true) == 3
    assert captures.lag(true, true) == 0


def test_the_longest_fault_is_that_of_the_first_capture_that_has_one():
    def capture(**faults):
        truth = {t: SimpleNamespace(swaps=[SimpleNamespace(first=0, stop=n) for n in lengths])
                 for t, lengths in faults.items()}  # fmt: skip
        return SimpleNamespace(texts=list(faults), truth=truth.get)

    empty, some = capture(a=[]), capture(a=[2], b=[1, 5])
    who, take, swap = captures.longest([empty, some], "swaps")
    assert who is some and take == "b" and swap.stop == 5
    with pytest.raises(ValueError, match="none of these captures has any"):
        captures.longest([empty], "swaps")


def test_angles_of_an_equilateral_and_of_a_right_triangle():
    V = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [0, 1, 0]])
    angles = captures.smallest_angles(TriangleMesh(V, np.array([[0, 1, 2], [0, 1, 3]])))
    np.testing.assert_allclose(angles, [60, 45])


def test_motion_of_two_components_has_all_its_variance_in_two(rng):
    X = rng.normal(size=(50, 2)) @ rng.normal(size=(2, 12))
    rms, share = captures.spectrum(X.reshape(50, 4, 3))
    assert share[0] < 0.999 and share[1] == pytest.approx(1)
    assert rms == pytest.approx(np.sqrt(((X - X.mean(axis=0)) ** 2).sum(axis=1).mean() / 4))
