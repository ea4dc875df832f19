"""A notebook as a lesson: its settings, what it claims of them, its exercises."""

from importlib import import_module
from pathlib import Path
from textwrap import fill

from tqdm.auto import tqdm

LESSONS = tuple(
    sorted(
        path.stem
        for path in (Path(__file__).parent / "lessons").glob("*.py")
        if path.stem != "__init__"
    )
)

_PAGE = 92  # letters in a line, which the page of a small screen holds


class BadSetting(ValueError):
    """A setting that the lesson cannot run with; a notebook shows its words alone."""

    def _render_traceback_(self):  # what IPython prints in place of a traceback
        return [str(self)]


class Lesson:
    """What a notebook was written for, and what becomes of it when a reader changes it.

    Parameters
    ----------
    name : str
        The notebook without its number, such as `"capture"`: a module of
        `facelab.course.lessons`, with `SETTINGS`, `OTHERS` and `EXERCISES`.
    **settings
        The values at the top of the notebook; what is not given stands at its reference.

    Attributes
    ----------
    changed : dict of str to str
        What departs from the reference, and how, in words.
    verdicts : dict of int to Verdict
        What became of each exercise, by number.

    Raises
    ------
    BadSetting
        If a setting is unknown or may not have its value: all of them at once.

    Examples
    --------
    >>> lesson = Lesson("capture", actor="F2")
    >>> lesson.claim("the jaw is widest", False, here="102 mm", reference="114 mm")
    Here: 102 mm; in the reference (actor 'M1') it was 114 mm. Not so here: the jaw is widest.
    >>> Lesson("capture", actor="Bob")
    Traceback (most recent call last):
    facelab.course.lesson.BadSetting: actor is 'Bob'; it may be 'M1', 'F1', 'M2' or 'F2'.
    """

    def __init__(self, name, **settings):
        if name not in LESSONS:
            raise BadSetting(f"name={name!r} is no lesson; there are {', '.join(LESSONS)}.")
        plan = import_module(f"facelab.course.lessons.{name}")
        self.name = name
        self.exercises = {e.number: e for e in plan.EXERCISES}
        self.verdicts = {}
        faults = []
        for key, value in settings.items():
            if key not in plan.SETTINGS:
                faults.append(f"{key} is no setting of this notebook; {_known(plan.SETTINGS)}")
            elif fault := plan.SETTINGS[key].fault(value):
                faults.append(f"{key} {fault}")
        if faults:
            raise BadSetting(". ".join(faults) + ".")
        self.changed = {
            key: f"{key} {plan.SETTINGS[key].reference!r}"
            for key, value in settings.items()
            if value != plan.SETTINGS[key].reference
        }

    @property
    def reference(self):
        """Whether everything stands as it did when the notebook was written."""
        return not self.changed

    def stand_in(self, what):
        """Say that other data than the reference's is at hand: claims are told, not asserted.

        Parameters
        ----------
        what : str
            What the reference had, such as `"the recorded takes"`.
        """
        self.changed["data"] = what

    def claim(self, words, holds, here="", reference=""):
        """Hold the notebook to its words: on the reference they must be true.

        On other settings nothing stops: what is so here is printed beside what it was.

        Parameters
        ----------
        words : str
            What is claimed, as a sentence without its full stop.
        holds : bool or callable
            Whether it is so; a callable that cannot answer here (IndexError, KeyError,
            ValueError) counts as not so.
        here, reference : str
            What was found, and what was found on the reference, with units.

        Raises
        ------
        AssertionError
            If it does not hold on the reference settings.
        """
        holds = self._holds(holds)
        if self.reference:
            if not holds:
                found = f" (found {here})" if here else ""
                raise AssertionError(f"{words}: not so on the reference settings{found}.")
            if here:
                self.say(f"{words}: {here}")
            return
        told = []
        if here:
            was = f" it was {reference}" if reference else " it is as the text says"
            told.append(
                f"Here: {here}; in the reference ({', '.join(self.changed.values())}){was}."
            )
        if not (holds and here):
            told.append(f"{'Still so' if holds else 'Not so'} here: {words}.")
        self.say(" ".join(told))

    def _holds(self, holds):
        if not callable(holds):
            return bool(holds)
        try:
            return bool(holds())
        except (IndexError, KeyError, ValueError):
            if self.reference:
                raise
            return False

    def check(self, number, answer, **given):
        """Judge the answer to an exercise, and say so in words.

        Parameters
        ----------
        number : int
        answer : object
            The reader's; `...` as long as there is none.
        **given
            What the check needs of the notebook.
        """
        verdict = self.exercises[number].judge(answer, **given)
        self.verdicts[number] = verdict
        self.say(f"Exercise {number}: {verdict.words}")

    def say(self, text):
        """Print sentences with lines that end between words, however narrow the page."""
        for line in str(text).splitlines():
            inner = "  " if line.startswith("- ") else ""
            print(fill(line, _PAGE, subsequent_indent=inner, break_long_words=False,
                       break_on_hyphens=False))  # fmt: skip

    def bar(self, items, words):
        """The items one by one under a bar that says what is done; for what takes seconds."""
        return tqdm(items, desc=words, leave=False)


def _known(settings):
    return f"it has {', '.join(settings)}" if settings else "it has none"
