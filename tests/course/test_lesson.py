"""Claims hold on the reference and only tell elsewhere; settings are checked in words."""

import pytest

from facelab.course import BadSetting, Lesson, Setting


def test_a_claim_that_fails_on_the_reference_stops():
    with pytest.raises(AssertionError, match=r"jaw is widest: not so .*found 102 mm"):
        Lesson("capture", actor="M1").claim("the jaw is widest", False, here="102 mm")


@pytest.mark.parametrize("holds", [True, False])
def test_a_claim_on_other_settings_tells_both_and_never_stops(holds, capsys):
    Lesson("capture", actor="F2").claim("it is so", holds, here="3 mm", reference="2 mm")
    said = capsys.readouterr().out
    assert "3 mm" in said and "2 mm" in said and "'M1'" in said
    assert ("Not so here: it is so" in said) != holds


def test_a_claim_that_cannot_be_judged_elsewhere_is_not_so(capsys):
    Lesson("capture", actor="F2").claim("it is so", lambda: [][0])
    assert "Not so here" in capsys.readouterr().out
    with pytest.raises(IndexError):
        Lesson("capture").claim("it is so", lambda: [][0])


def test_other_data_count_as_another_setting(capsys):
    lesson = Lesson("capture")
    lesson.stand_in("the recorded takes")
    lesson.claim("it is so", False)
    assert not lesson.reference and "Not so here" in capsys.readouterr().out


def test_all_bad_settings_are_named_at_once_without_a_traceback():
    with pytest.raises(BadSetting) as refused:
        Lesson("capture", actor="Bob", colour="red")
    (words,) = refused.value._render_traceback_()
    assert "actor is 'Bob'" in words and "'F2'" in words and "colour is no setting" in words


@pytest.mark.parametrize(
    ("setting", "value", "words"),
    [
        (Setting(0.7, within=(0, 1)), 1.2, "0 to 1"),
        (Setting(0.7, within=(0, 1)), "half", "any number"),
        (Setting(9, within=(2, 20)), 9.5, "whole number"),
        (Setting(9, within=(2, 20)), True, "whole number"),
        (Setting((5, 9), within=(1, 20)), (5, 21), "holds 21"),
        (Setting((5, 9), within=(1, 20)), 5, "must be a tuple"),
        (Setting((5, 9), within=(1, 20)), (), "must be a tuple"),
        (Setting("M1", choices=("M1", "F1")), "f1", "'M1' or 'F1'"),
    ],
)
def test_a_value_that_may_not_be_is_refused_in_words(setting, value, words):
    assert words in setting.fault(value)


def test_a_value_that_may_be_has_no_fault():
    assert Setting(0.7, within=(0, 1), unit="mm").fault(1) is None
    assert Setting((5, 9), within=(1, 20)).fault([7, 11, 15]) is None


def test_what_a_lesson_says_breaks_between_words_and_keeps_its_own_lines(capsys):
    said = "a sketch of 6,705 vertices, where the rig has 6,706; " * 5
    Lesson("capture").say(f"- {said}\nrig-of-one")
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 92 and lines[1].startswith("  ")
    assert " ".join(line.strip() for line in lines[:-1]) == f"- {said}".rstrip()
    assert lines[-1] == "rig-of-one"
