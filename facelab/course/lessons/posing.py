"""The notebook on posing."""

SETTINGS = {}
OTHERS = ()
EXERCISES = ()
