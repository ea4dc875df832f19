import numpy as np
import pytest
from recordings import code, drop_frame

from facelab.files.takes.recording import Recording
from facelab.files.takes.timecodes import timing


def placed(codes):
    rows = list(range(2, 2 + len(codes)))
    return timing(Recording("take.csv", [], None, rows, codes=codes))


def complete(codes, fps):
    found = placed(codes)
    np.testing.assert_array_equal(found.slots, np.arange(len(codes)))
    assert found.fps == pytest.approx(fps, rel=1e-9)
    assert not found.gaps
    return found


@pytest.mark.parametrize(
    "base, every, fps",
    [
        *((60, 2, 30), (60, 1, 60), (30, 1, 30), (24, 1, 24), (25, 1, 25), (120, 4, 30)),
        *((60, 4, 15), (15, 1, 15), (48, 1, 48), (100, 2, 50), (30, 6, 5), (12, 1, 12)),
    ],
)
def test_rate_and_base_of_the_time_code_are_told_apart(base, every, fps):
    # two seconds and a half from the middle of a second, so that codes wrap twice
    complete([code(base // 2 + every * i, base) for i in range(int(2.5 * base / every))], fps)


@pytest.mark.parametrize("base", [30, 60])
def test_a_quarter_of_an_hour_of_drop_frame_codes_lacks_nothing(base):
    start = 17982 * base // 30 - 600
    found = complete([drop_frame(start + i, base) for i in range(800 * base)], base * 1000 / 1001)
    assert "drop-frame" in found.notes[0]


def test_drop_frame_codes_pass_midnight():
    day = 17982 * 144
    complete([drop_frame(day - 700 + i, 30) for i in range(1400)], 30000 / 1001)


@pytest.mark.parametrize("base, every", [(30, 1), (60, 1), (60, 2)])
def test_drop_frame_codes_without_their_mark_are_known_by_what_they_pass_over(base, every):
    first = (17982 * 60 - 600) * base // 30
    codes = [drop_frame(first + every * i, base) for i in range(200 * base // every)]
    fps = base / every * 1000 / 1001
    found = complete([c.replace(";", ":") for c in codes], fps)
    assert f"{base // 15} numbers are passed over at each minute" in found.notes[0]


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_frames_lost_at_one_minute_of_several_make_no_drop_frame(lost):
    codes = [code(i, start=50) for i in range(4000) if not 300 <= i < 300 + lost]
    assert placed(codes).fps == 30


def test_drop_frame_marks_on_numbers_that_are_never_passed_over_are_not_believed():
    found = complete([code(i, mark=";", start=59) for i in range(90)], 30)
    assert "not taken so" in found.notes[0]


@pytest.mark.parametrize("base, every", [(24, 1), (24, 2), (25, 1), (48, 2), (50, 1)])
@pytest.mark.parametrize("first", [0, 10])
def test_drop_frame_marks_on_rates_that_have_no_drop_frame_are_said(base, every, first):
    codes = [code(first + every * i, base, mark=";") for i in range(120)]
    found = Recording("take.csv", [], None, list(range(120)), codes=codes)
    times = timing(found)
    np.testing.assert_array_equal(times.slots, np.arange(120))
    assert times.fps == base / every
    assert f"count {base}: read as {base} frames/s without it" in found.warned[0]


@pytest.mark.parametrize("every", [1, 2, 3, 5, 6])
@pytest.mark.parametrize("base", [30, 60])
def test_drop_frame_codes_of_every_second_frame_stay_drop_frame(base, every, rng):
    numbers = [every * i for i in range(900)]
    complete([drop_frame(n, base) for n in numbers], base * 1000 / 1001 / every)
    kept = np.sort(rng.choice(900, size=860, replace=False))
    found = placed([drop_frame(numbers[i], base) for i in kept])
    np.testing.assert_array_equal(found.slots, kept - kept[0])


@pytest.mark.parametrize("fps, base", [(25, 30), (24, 30), (24, 60), (25, 60), (50, 60), (48, 60)])
@pytest.mark.parametrize("to_whole", [np.floor, np.round])
def test_frames_numbered_in_coarse_beats_of_another_rate_make_up_no_gaps(fps, base, to_whole):
    complete([code(int(to_whole(i * base / fps)), base) for i in range(300)], fps)
    dropped = [drop_frame(int(to_whole(i * base / fps)), base) for i in range(300)]
    complete(dropped, fps * 1000 / 1001)


@pytest.mark.parametrize("base", [30, 60])
def test_milliseconds_behind_the_frame_number_are_no_parts_of_it(base):
    codes = [
        f"00:00:{i // base:02d}:{i % base:02d}.{int(1000 * (i / base % 1)):03d}" for i in range(600)
    ]
    assert "milliseconds" in complete(codes, base).notes[0]


@pytest.mark.parametrize("decimals", [2, 3, 6])
@pytest.mark.parametrize("fps", [24, 25, 30, 50, 60])
def test_seconds_and_clock_times_are_read(fps, decimals):
    complete([f"{5 + i / fps:.{decimals}f}" for i in range(300)], fps)
    clock = [divmod(5 + i / fps, 60) for i in range(3000)]
    if decimals > 2:
        complete([f"10:{int(m):02d}:{s:0{decimals + 3}.{decimals}f}" for m, s in clock], fps)


def test_hundredths_that_may_be_frames_are_refused():
    with pytest.raises(ValueError, match=r"take\.csv, line 2: .* may count frames or hundredths"):
        placed([f"10:00:{i // 30:02d}.{i % 30:02d}" for i in range(90)])


def test_numbers_without_a_rate_are_refused():
    with pytest.raises(ValueError, match=r"line 2: 1, 2, ... count rows.*fps=30"):
        placed([str(i) for i in range(1, 50)])


@pytest.mark.parametrize("speed, fps", [(0.995, 30.151), (1.005, 29.851), (1.001, 30000 / 1001)])
def test_a_clock_that_runs_at_another_pace_neither_loses_nor_invents_frames(speed, fps):
    # after 3000 frames a clock 0.5 % off is 15 frames off, yet every step is nearly one frame
    assert complete([code(0.4 + i * speed) for i in range(3000)], fps)


def test_the_pace_of_a_phone_is_that_of_its_rate():
    complete([code(1.65 + 1.99975 * i, 60) for i in range(4000)], 30)


@pytest.mark.parametrize("jitter", [0.1, 0.2, 0.3])
def test_jitter_moves_no_frame_and_no_rate(jitter, rng):
    for _ in range(5):
        off = rng.uniform(-jitter, jitter, size=300)
        complete([code(5 + i + j) for i, j in enumerate(off)], 30)


def test_lost_frames_among_jitter_are_found_in_their_place(rng):
    present = np.sort(rng.choice(300, size=280, replace=False))
    present = present[present >= present[0]] - present[0]
    off = rng.uniform(-0.2, 0.2, size=280)
    found = placed([code(5 + i + j) for i, j in zip(present, off, strict=True)])
    np.testing.assert_array_equal(found.slots, present)
    assert found.fps == 30


@pytest.mark.parametrize("first, n_frames, fps", [(31, 1, 60), (3, 10, 30), (35, 10, 60)])
def test_a_take_within_one_second_counts_in_thirtieths_or_sixtieths(first, n_frames, fps):
    found = complete([code(first + i, fps) for i in range(n_frames)], fps)
    assert "within one second" in found.notes[0]


def test_two_stretches_far_apart_are_two_stretches():
    found = placed([code(i + 30 * 3600 * (i > 99)) for i in range(200)])
    np.testing.assert_array_equal(found.slots, np.arange(200))
    assert found.gaps == {100: pytest.approx(3600)}
