import os
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import facelab
from facelab.motion import MarkerSequence
from facelab.registration import fit_markers, register_sequence, rest_markers
from facelab.studies.marker_faults import (
    Planted,
    by_spacing,
    measure,
    planted,
    thinned,
    without_faults,
)

BESIDE = Path(__file__).resolve().parents[3] / "shared" / "captures" / "animface"
KEEP = ("chin", "nose_tip", "nose_bridge_1", "mouth_corner_left", "mouth_corner_right", "lip_upper",
        "brow_left_1", "brow_right_1", "brow_left_5", "brow_right_5")  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def capture():
    return facelab.data.load_capture("M1", size="small", progress=False)


@pytest.fixture(scope="module")
def at_rest(capture):
    return rest_markers([capture.markers(name) for name in capture.texts])


def test_thinned_markers_keep_their_distance_and_those_asked_for(capture, at_rest):
    rest, names = at_rest
    few = thinned(capture.markers("rage_1"), rest, names, 20.0, KEEP)
    assert set(KEEP) <= set(few.names)
    at = [names.index(n) for n in few.names if n not in KEEP]
    apart = np.linalg.norm(rest[at][:, None] - rest[at], axis=2)
    assert apart[apart > 0].min() >= 20 and 20 < len(few.names) < 80


def test_what_is_planted_is_what_differs(capture, at_rest):
    take = capture.markers("rage_1")
    spoiled = planted(take, share=0.02, sizes=(6.0, 9.0), n_swaps=3, random_state=0)
    off = np.linalg.norm(spoiled.take.positions - take.positions, axis=2)
    strayed = spoiled.strays > 0
    np.testing.assert_allclose(off[strayed], spoiled.strays[strayed], rtol=1e-5)
    assert 6 <= spoiled.strays[strayed].min() and spoiled.strays.max() <= 9
    assert strayed.sum() / take.visible.sum() == pytest.approx(0.02, abs=0.005)
    names, changed = spoiled.take.names, (off > 0) & ~strayed
    swapped = {
        (f, names.index(n)) for p, frames in spoiled.swaps.items() for n in p for f in frames
    }
    assert (
        len(spoiled.swaps) == 3 and {(int(f), int(m)) for f, m in np.argwhere(changed)} == swapped
    )
    again = planted(take, share=0.02, sizes=(6.0, 9.0), n_swaps=3, random_state=0)
    np.testing.assert_array_equal(again.take.positions, spoiled.take.positions)


def test_counts_are_those_of_a_hand(monkeypatch, capture, at_rest):
    """Of two strays one found, and a true marker thrown away; an exchange half put back."""
    rest, names = at_rest
    take = capture.markers("rage_1").select(names)[:4]
    P = np.repeat(rest[None], 4, axis=0)
    take = MarkerSequence(P, names, 60)
    strays = np.zeros(take.visible.shape)
    strays[0, 0], strays[1, 1], strays[2, 2] = 10, 10, 3
    pair = frozenset(names[3:5])

    class Registered:
        seen = np.ones(take.visible.shape, dtype=bool)
        faults = (facelab.registration.Fault("swap", 1, 2, tuple(names[3:5])),
                  facelab.registration.Fault("swap", 1, 2, tuple(names[8:10])))  # fmt: skip

    class Fit:
        pass

    Registered.seen[[0, 3], [0, 7]] = False
    Fit.names = names
    monkeypatch.setattr(
        "facelab.studies.marker_faults.register_sequence", lambda *a, **k: Registered
    )
    found = measure(Fit, Planted(take, strays, {pair: {1, 2}}), least=5)
    assert found == pytest.approx((0.5, 0.5, 0.5, 0.5, 1 / (take.visible.sum() - 3 - 4)))


def test_planted_faults_are_found_and_true_markers_kept_at_every_spacing(capture):
    takes = [without_faults(capture, name) for name in ("rage_1", "contempt_5")]
    rows = by_spacing(facelab.load_template(4375), takes, (0, 12, 20, 30))
    apart, counts, found = zip(*rows, strict=True)
    assert list(apart) == sorted(apart) and list(counts) == sorted(counts, reverse=True)
    assert apart[0] < 13 and apart[-1] > 30
    for row in found:
        assert row.recall > 0.95 and row.precision > 0.95
        assert row.swap_recall > 0.9 and row.swap_precision > 0.95
        assert row.lost < 0.001


@pytest.mark.parametrize("name", ["jaw", "eyebrows"])
def test_real_markers_keep_their_peaks_and_planted_faults_among_them_are_found(name):
    root = os.environ.get("FACELAB_ANIMFACE") or (BESIDE if BESIDE.is_dir() else None)
    if root is None:
        pytest.skip("FACELAB_ANIMFACE is not set: no AnimFace capture on this machine")
    take = facelab.load_markers(name, root).renamed(facelab.data.ANIMFACE_LANDMARKS)
    fit = fit_markers(facelab.load_template(4375), *rest_markers(take))
    clean = register_sequence(fit, take, progress=False)
    assert clean.seen.all() and clean.valid.all() and not clean.faults
    found = measure(fit, planted(take, random_state=0), least=13)  # markers are 27 mm apart
    assert found.recall > 0.95 and found.precision > 0.95 and found.lost < 0.001
    assert found.swap_recall > 0.9 and found.swap_precision > 0.95
