"""The notebook on models."""

SETTINGS = {}
OTHERS = ()
EXERCISES = ()
