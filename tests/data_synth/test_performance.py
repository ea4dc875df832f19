from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_synth.actors import ACTORS
from data_synth.performance import SENTENCES, perform_facs, perform_rom, perform_sentence
from data_synth.performance.combinations import OPPOSED, facs_combinations
from data_synth.performance.emotion import EMOTIONS
from data_synth.performance.manner import apply_manner, manner_matrix
from data_synth.performance.speech import DIPHTHONGS, VISEMES, coarticulate, sounds
from data_synth.performance.tracks import blinks
from data_synth.units import UNIT_TABLE, UNITS, expand

AT = {name: k for k, name in enumerate(UNITS)}
LINES = [(actor, sentence) for actor in ACTORS for sentence in SENTENCES]


@pytest.fixture(scope="module")
def spoken():
    """Every sentence by every actor, as the default set has them."""
    return {(a, s): perform_sentence(a, s) for a, s in LINES}


def track(performance, name):
    """The strongest of the units that a name stands for, frame by frame."""
    return performance.weights.weights[:, [AT[u] for u in expand(name)]].max(axis=1)


# --- units ----------------------------------------------------------------------------------------


def test_there_are_forty_units_each_described():
    assert len(UNITS) == len(set(UNITS)) == 40
    assert all(unit.description and unit.muscle for unit in UNIT_TABLE.values())
    left = {u[:-1] for u in UNITS if u.endswith("L")}
    assert left == {u[:-1] for u in UNITS if u.endswith("R")}


def test_a_name_without_side_is_both_sides():
    assert expand("AU12") == ("AU12L", "AU12R")
    assert expand("AU12R") == ("AU12R",)
    assert expand("AU4") == ("AU4",)


@pytest.mark.parametrize("name", ["AU99", "AU4L", "12", ""])
def test_an_unknown_unit_names_the_known_ones(name):
    with pytest.raises(ValueError, match=f"unit='{name}' is unknown; .*AU1, AU2L, .*AU38"):
        expand(name)


# --- the script -----------------------------------------------------------------------------------


def test_eighteen_sentences_four_to_train_and_two_to_test_of_each_emotion():
    count = Counter((s.emotion, s.split) for s in SENTENCES.values())
    assert count == {(e, s): n for e in EMOTIONS for s, n in (("train", 4), ("test", 2))}
    assert len({s.text for s in SENTENCES.values()}) == 18


def test_every_sound_has_a_viseme_and_every_sentence_a_stress():
    for sentence in SENTENCES.values():
        phones = {p.rstrip("1") for p in sentence.phones}
        assert phones <= set(VISEMES) | set(DIPHTHONGS)
        assert any(p.endswith("1") for p in sentence.phones)


# --- sentences ------------------------------------------------------------------------------------


def test_weights_stay_within_bounds_and_sentences_within_two_to_four_seconds(spoken):
    for p in spoken.values():
        assert p.weights.names == UNITS
        assert p.weights.weights.min() >= 0
        assert p.weights.weights.max() <= 1
        assert 2 <= p.weights.duration <= 4
        assert len(p.rotation) == len(p.sway) == p.weights.n_frames


def test_a_sentence_begins_and_ends_at_rest(spoken):
    resting = [n for n in UNITS if not n.startswith("AU45")]  # a blink may fall anywhere
    columns = [AT[n] for n in resting]
    for p in spoken.values():
        assert p.weights.weights[[0, -1]][:, columns].max() < 0.02


def test_equal_seeds_give_equal_performances_and_others_do_not():
    a, b, c = (perform_sentence("F1", "rage_2", 30, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(a.weights.weights, b.weights.weights)
    np.testing.assert_array_equal(a.rotation, b.rotation)
    n = min(len(a.sway), len(c.sway))
    assert np.abs(a.weights.weights[:n] - c.weights.weights[:n]).max() > 0.1


def test_motion_is_smooth_at_120_frames_a_second(spoken):
    """The fastest thing a face does is a blink: shut in 80 ms, at most 0.2 a frame."""
    for p in spoken.values():
        step = np.abs(np.diff(p.weights.weights, axis=0)).max(axis=0)
        assert step.max() < 0.2
        assert np.delete(step, [AT["AU45L"], AT["AU45R"], AT["AU5"]]).max() < 0.15


def test_lips_meet_for_p_b_and_m_and_the_jaw_opens_for_vowels():
    """What speech alone does, against the times of its own sounds."""
    for actor in ACTORS:
        for name in ("pride_5", "rage_6"):
            rng = np.random.default_rng(3)
            middle, lengths, targets, firm, *_ = sounds(SENTENCES[name], ACTORS[actor].manner, rng)
            W = coarticulate(middle, middle, lengths, targets, firm)
            lips = targets[:, AT["AU24"]] > 0.5
            wide = targets[:, AT["AU26"]] > 0.5
            assert lips.any()
            assert wide.any()
            assert W[lips, AT["AU24"]].min() > 0.30
            assert W[lips, AT["AU26"]].max() < 0.25
            assert W[wide, AT["AU26"]].min() > 0.35


def test_sounds_lean_towards_their_neighbours():
    """Before a rounded vowel the same consonant is rounder than before a spread one."""
    targets = np.array([[0.1, 0.4], [0.8, 0.0]]), np.array([[0.1, 0.4], [0.0, 0.5]])
    middle, lengths, firm = np.array([0.1, 0.2]), np.array([0.1, 0.1]), np.ones(2)
    round_, spread = (coarticulate(np.array([0.1]), middle, lengths, T, firm)[0] for T in targets)
    assert round_[0] > spread[0] + 0.02
    assert round_[1] < spread[1]


def test_each_emotion_shows_its_units(spoken):
    def mean(unit, emotion):
        return np.mean([track(p, unit).mean() for (_, s), p in spoken.items() if emotion in s])

    for unit in ("AU4", "AU5", "AU9", "AU23", "AU38"):
        assert mean(unit, "rage") > 2 * max(mean(unit, "pride"), mean(unit, "contempt"))
    assert mean("AU14", "contempt") > 2 * max(mean("AU14", "pride"), mean("AU14", "rage"))
    pitch = {
        e: np.mean([p.weights.angles["HeadPitch"].mean() for (_, s), p in spoken.items() if e in s])
        for e in EMOTIONS
    }
    assert pitch["pride"] > 0.03 > pitch["rage"]


@pytest.mark.parametrize("actor", ACTORS)
def test_contempt_is_one_sided_and_on_the_actors_own_side(spoken, actor):
    sneer, other = ACTORS[actor].manner.sneer, "LR".replace(ACTORS[actor].manner.sneer, "")
    for name in ("contempt_1", "contempt_6"):
        p = spoken[actor, name]
        assert track(p, f"AU14{sneer}").mean() > 4 * track(p, f"AU14{other}").mean()


def test_stress_raises_the_brows_in_pride(spoken):
    peaks = [track(p, "AU1").max() for (_, s), p in spoken.items() if "pride" in s]
    means = [track(p, "AU1").mean() for (_, s), p in spoken.items() if "pride" in s]
    assert np.median(np.array(peaks) / means) > 1.8


def test_blinks_close_faster_than_they_open_at_a_natural_rate():
    fps, minutes = 240.0, 4
    lids = blinks(np.random.default_rng(1), int(minutes * 60 * fps), fps, 17)
    shut = lids > 0.5
    edges = np.diff(shut.astype(int))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    assert 10 < len(starts) / minutes < 30
    closing, opening = [], []
    for a, b in zip(starts, stops, strict=True):
        rise = np.flatnonzero(lids[: a + 1] == 0)[-1]
        peak = rise + lids[rise:b].argmax()
        closing.append((peak - rise) / fps)
        opening.append(np.flatnonzero(lids[b:] == 0)[0] / fps)
    assert 0.06 < np.median(closing) < 0.10
    assert 0.06 < np.median(opening) < 0.10  # the second half of 150 ms


def test_the_turn_of_the_head_is_the_one_its_angles_state(spoken):
    p = spoken["M2", "contempt_3"]
    nose = Rotation.from_rotvec(p.rotation).apply([0, 0, 1])
    a = p.weights.angles
    np.testing.assert_allclose(np.arctan2(nose[:, 0], nose[:, 2]), a["HeadYaw"], atol=1e-12)
    np.testing.assert_allclose(np.arcsin(nose[:, 1]), a["HeadPitch"], atol=1e-12)
    assert np.degrees(np.linalg.norm(p.rotation, axis=1)).max() < 30


@pytest.mark.parametrize(
    "actor, sentence, words",
    [
        ("M3", "rage_1", "actor='M3' is unknown; choose one of 'M1', 'F1', 'M2', 'F2'"),
        ("M1", "joy_1", "sentence='joy_1' is unknown; choose one of 'pride_1', .*'contempt_6'"),
    ],
)
def test_unknown_actors_and_sentences_name_the_known_ones(actor, sentence, words):
    with pytest.raises(ValueError, match=words):
        perform_sentence(actor, sentence)


@pytest.mark.parametrize("fps", [0, 5, np.nan])
def test_a_rate_too_low_for_speech_is_refused(fps):
    with pytest.raises(ValueError, match=r"fps=.*10 or more"):
        perform_sentence("M1", "rage_1", fps)


# --- manner ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("actor", ACTORS)
def test_manner_keeps_weights_within_bounds_and_rest_at_rest(actor, rng):
    A = manner_matrix(actor)
    assert A.shape == (40, 40)
    assert A.min() >= 0
    assert A.max() <= 1
    extremes = np.vstack([np.zeros(40), np.ones(40), rng.random((20, 40))])
    W = apply_manner(extremes, actor)
    assert W.min() >= 0
    assert W.max() <= 1
    assert not W[0].any()


@pytest.mark.parametrize("actor", ACTORS)
def test_small_weights_are_mixed_by_the_matrix(actor):
    small = 1e-6 * np.eye(40)
    np.testing.assert_allclose(apply_manner(small, actor), 1e-6 * manner_matrix(actor), atol=1e-11)


@pytest.mark.parametrize("actor", ACTORS)
def test_one_side_lags_behind_and_couplings_stay_on_their_side(actor):
    A, weak = manner_matrix(actor), ACTORS[actor].manner.weak_side
    strong = "LR".replace(weak, "")
    strength = dict(zip(UNITS, np.diag(A), strict=True))
    pairs = [u[:-1] for u in UNITS if u.endswith("L") and "45" not in u]
    ratio = np.mean([strength[p + weak] / strength[p + strong] for p in pairs])
    assert ratio == pytest.approx(1 - ACTORS[actor].manner.asymmetry, abs=0.03)  # +- 3 % by unit
    for i, cause in enumerate(UNITS):
        for j, effect in enumerate(UNITS):
            if {cause[-1], effect[-1]} == {"L", "R"}:
                assert A[i, j] == 0


def test_no_two_actors_move_alike():
    matrices = [manner_matrix(a) for a in ACTORS]
    for i in range(4):
        for j in range(i):
            assert np.abs(matrices[i] - matrices[j]).max() > 0.2


# --- range of motion and FACS ---------------------------------------------------------------------


def test_eighty_six_combinations_of_one_to_four_units_each_once():
    combinations = facs_combinations()
    assert len(set(combinations)) == len(combinations) == 86
    assert {len(c) for c in combinations} == {1, 2, 3, 4}
    assert {c[0] for c in combinations if len(c) == 1} == set(UNITS)
    assert combinations == facs_combinations(0)
    assert combinations != facs_combinations(1)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_no_combination_asks_a_face_for_what_it_cannot_do(seed):
    for names in facs_combinations(seed):
        columns = [AT[u] for n in names for u in expand(n)]
        assert len(set(columns)) == len(columns)
        pairs = {frozenset((a, b)) for a in columns for b in columns if a != b}
        assert not pairs & OPPOSED


@pytest.mark.parametrize("number", [1, 5, 41, 60, 86])
def test_a_combination_rises_to_a_peak_and_falls(number):
    p = perform_facs("M1", number)
    shown = [AT[u] for n in facs_combinations()[number - 1] for u in expand(n)]
    W = p.weights.weights
    assert p.text == " + ".join(facs_combinations()[number - 1])
    assert 1.5 < p.weights.duration < 2.5
    assert not W[[0, -1]][:, shown].any()
    middle = W[len(W) // 3 : 2 * len(W) // 3]
    assert (middle[:, shown].max(axis=0) > 0.5).all()
    coupled = np.flatnonzero(manner_matrix("M1")[shown].any(axis=0))
    blink = [AT["AU45L"], AT["AU45R"]]
    others = np.setdiff1d(np.arange(40), [*coupled, *blink])
    assert W[:, others].max() == 0


@pytest.mark.parametrize("number", [0, 87])
def test_a_combination_that_is_not_there_is_refused(number):
    with pytest.raises(
        ValueError, match=f"number={number}, but there are 86 combinations: 1 to 86"
    ):
        perform_facs("M1", number)


def test_the_range_of_motion_takes_every_unit_to_its_extreme():
    p = perform_rom("M1")
    assert 60 <= p.weights.duration <= 90
    assert p.weights.weights.min() >= 0
    assert (p.weights.weights.max(axis=0) > 0.55 * np.diag(manner_matrix("M1"))).all()
    assert not p.weights.weights[[0, -1]].any()


def test_all_of_m1_at_15_frames_a_second_is_about_the_4787_of_the_paper(spoken):
    frames = sum(spoken["M1", s].weights.n_frames for s in SENTENCES)
    frames += sum(perform_facs("M1", n).weights.n_frames for n in range(1, 87))
    frames += perform_rom("M1").weights.n_frames
    assert frames * 15 / 120 == pytest.approx(4787, rel=0.01)
