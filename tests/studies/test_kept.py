import numpy as np
import pytest

from facelab.studies.kept import kept


@pytest.fixture(autouse=True)
def _cache(tmp_path, monkeypatch):
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))


def _found(of):
    """What is kept of a study that found 1, or None if it is computed once more."""
    made = []
    kept("kept.test", of, lambda: made.append(1) or {"found": 1})
    return None if made else 1


def test_a_study_is_computed_once_for_the_same_data_and_settings():
    assert _found([np.arange(3.0), "rage_5", 0.2]) is None
    assert _found([np.arange(3.0), "rage_5", 0.2]) == 1


@pytest.mark.parametrize(
    "other",
    [
        [np.array([0.0, 1.0, 2.1]), "rage_5", 0.2],
        [np.arange(3), "rage_5", 0.2],
        [np.arange(3.0)[:, None], "rage_5", 0.2],
        [np.arange(3.0), "rage_1", 0.2],
        [np.arange(3.0), "rage_5", 0.3],
    ],
    ids=["values", "kind", "shape", "take", "share"],
)
def test_what_differs_in_any_part_is_computed_anew_and_both_are_kept(other):
    first = [np.arange(3.0), "rage_5", 0.2]
    _found(first)
    assert _found(other) is None
    assert _found(first) == 1 == _found(other)
