"""Exercises answer in words; each has a hint, a solution and answers that are wrong."""

from importlib import import_module

import pytest

from facelab.course import Exercise, Lesson, fold
from facelab.course.lesson import LESSONS

PLANS = {name: import_module(f"facelab.course.lessons.{name}") for name in LESSONS}
ALL = [
    pytest.param(exercise, id=f"{name}-{exercise.number}")
    for name, plan in PLANS.items()
    for exercise in plan.EXERCISES
]


def half(answer):
    return None if answer == 0.5 else f"{abs(answer - 0.5):g} off; what is half of one?"


HALF = Exercise(1, half, "it is", "cut it", "answer = 0.5", ("answer = 1",))


def test_an_untouched_answer_is_neither_right_nor_wrong():
    verdict = HALF.judge(...)
    assert verdict.right is None and "dots" in verdict.words


def test_a_wrong_answer_says_how_it_is_wrong_and_a_right_one_why():
    assert HALF.judge(1).right is False and "0.5 off; what" in HALF.judge(1).words
    assert HALF.judge(0.5).right and "it is" in HALF.judge(0.5).words


def test_an_answer_of_the_wrong_kind_is_wrong_in_words_and_never_an_error():
    assert HALF.judge("a half").right is False and "cannot be judged" in HALF.judge("a half").words


def test_a_lesson_prints_and_keeps_its_verdicts(capsys):
    lesson = Lesson("capture")
    lesson.exercises = {1: HALF}
    lesson.check(1, 0.5)
    assert lesson.verdicts[1].right and "Exercise 1: right" in capsys.readouterr().out


def test_what_is_folded_away_is_hint_and_solution():
    text = fold(HALF)
    assert text.count("<details>") == text.count("</details>") == 2
    assert "cut it" in text and "answer = 0.5" in text


@pytest.mark.parametrize("exercise", ALL)
def test_every_exercise_has_all_its_parts(exercise):
    assert exercise.right and exercise.hint and exercise.wrong
    for lines in (exercise.solution, *exercise.wrong):
        compile(lines, "answer", "exec")


@pytest.mark.parametrize("name", LESSONS)
def test_exercises_are_numbered_in_their_order(name):
    numbers = [e.number for e in PLANS[name].EXERCISES]
    assert numbers == list(range(1, len(numbers) + 1))


@pytest.mark.parametrize("name", LESSONS)
def test_other_settings_are_allowed_ones(name):
    for other in PLANS[name].OTHERS:
        assert Lesson(name, **other).changed, f"{other} is the reference"
