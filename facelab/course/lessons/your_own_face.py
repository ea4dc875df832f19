"""The notebook on your own face."""

SETTINGS = {}
OTHERS = ()
EXERCISES = ()
