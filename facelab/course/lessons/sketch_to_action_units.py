"""The notebook on sketch to action units."""

SETTINGS = {}
OTHERS = ()
EXERCISES = ()
