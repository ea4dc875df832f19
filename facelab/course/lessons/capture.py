"""The notebook on capture."""

from facelab.course.settings import Setting

ACTORS = ("M1", "F1", "M2", "F2")
SETTINGS = {"actor": Setting("M1", choices=ACTORS)}
OTHERS = ()
EXERCISES = ()
