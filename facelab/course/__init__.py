"""What the notebooks of the course share: settings, claims, exercises that answer, tables."""

from facelab.course.exercises import Exercise, Verdict, fold, number
from facelab.course.heads import Head, load_head, rms_by_name
from facelab.course.lesson import BadSetting, Lesson
from facelab.course.settings import Setting
from facelab.course.tables import Table

__all__ = [
    "BadSetting",
    "Exercise",
    "Head",
    "Lesson",
    "Setting",
    "Table",
    "Verdict",
    "fold",
    "load_head",
    "number",
    "rms_by_name",
]
