"""The notebook on segmentation."""

SETTINGS = {}
OTHERS = ()
EXERCISES = ()
