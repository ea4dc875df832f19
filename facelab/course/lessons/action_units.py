"""The notebook on action units."""

SETTINGS = {}
OTHERS = ()
EXERCISES = ()
