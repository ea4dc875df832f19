"""One module for a notebook, named as it is without its number.

`SETTINGS` (name to `Setting`) is what stands in its cell with the tag "settings"; `OTHERS` are
settings with which it must run too, as dicts; `EXERCISES` are its exercises in their order.
"""
