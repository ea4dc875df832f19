"""Exercises that answer in words, with a hint and a solution folded away."""

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real

import numpy as np


@dataclass(frozen=True)
class Verdict:
    """What became of an answer: `right` is None as long as there is none."""

    right: bool | None
    words: str


@dataclass(frozen=True)
class Exercise:
    """An exercise of a notebook; the question itself stands in the notebook.

    Parameters
    ----------
    number : int
    check : callable
        Takes the answer and what the notebook gives; returns None if it is right, else what is
        wrong with it, in words that lead on. May raise TypeError or ValueError with such words.
    right : str
        What is said when it is right.
    hint : str
        Markdown.
    solution : str
        Lines of Python that stand in place of the reader's.
    wrong : tuple of str
        The same for answers that one would try, and that must be refused with words.

    Examples
    --------
    >>> two = Exercise(1, lambda a: None if a == 2 else "too large" if a > 2 else "too small",
    ...                "two it is", "count", "answer = 2", ("answer = 3",))
    >>> two.judge(3).words, two.judge(2).words
    ('not yet: too large.', 'right: two it is.')
    >>> two.judge(...).words
    'put your answer in place of the dots.'
    """

    number: int
    check: Callable
    right: str
    hint: str
    solution: str
    wrong: tuple

    def judge(self, answer, **given):
        """The verdict on an answer: Verdict."""
        if answer is ...:
            return Verdict(None, "put your answer in place of the dots.")
        try:
            fault = self.check(answer, **given)
        except (TypeError, ValueError, KeyError, IndexError) as error:
            fault = f"this cannot be judged ({error})"
        if fault:
            return Verdict(False, f"not yet: {fault.rstrip('.')}.")
        return Verdict(True, f"right: {self.right.rstrip('.')}.")


def number(answer, what="a number"):
    """The answer as a float; TypeError in words if it is none.

    >>> number(2)
    2.0
    >>> number("two")
    Traceback (most recent call last):
    TypeError: 'two' is not a number
    """
    if not isinstance(answer, Real) or isinstance(answer, bool) or not np.isfinite(answer):
        raise TypeError(f"{answer!r} is not {what}")
    return float(answer)


def fold(exercise):
    """The hint and the solution of an exercise, folded away: markdown.

    >>> two = Exercise(1, None, "", "count", "answer = 2", ())
    >>> fold(two).splitlines()[0]
    '<details><summary>Hint</summary>'
    """
    return (
        f"<details><summary>Hint</summary>\n\n{exercise.hint}\n\n</details>\n"
        f"<details><summary>Solution</summary>\n\n```python\n{exercise.solution}\n```\n\n</details>"
    )
