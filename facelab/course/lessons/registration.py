"""The notebook on registration."""

SETTINGS = {}
OTHERS = ()
EXERCISES = ()
