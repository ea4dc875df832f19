"""What the notebooks of the course share: settings, claims, exercises that answer, tables."""

from facelab.course.exercises import Exercise, Verdict, fold, number
from facelab.course.heads import Head, Scan, load_head, load_scan, rms_by_name
from facelab.course.lesson import BadSetting, Lesson
from facelab.course.lessons.sketch_to_action_units import EXPRESSIONS
from facelab.course.settings import Setting
from facelab.course.tables import Table
from facelab.course.toys import two_humps

__all__ = [
    "EXPRESSIONS",
    "BadSetting",
    "Exercise",
    "Head",
    "Lesson",
    "Scan",
    "Setting",
    "Table",
    "Verdict",
    "fold",
    "load_head",
    "load_scan",
    "number",
    "rms_by_name",
    "two_humps",
]
