"""What a step of a session did, in a few words: found from the states before and after it."""

import numpy as np

from facelab.looks.gaze import look_units

_BUTTONS = {
    "restore": "another pose",
    "reset": "reset",
    "keep": "pins baked",
    "mirror": "swap sides",
}
_SIDES = {"left": "L → R", "right": "R → L"}


def pose_step(before, after, name_of, models, edit=None):
    """What led from one `PoseState` to the next.

    Parameters
    ----------
    before, after : PoseState
    name_of : callable
        Gives the name of a vertex.
    models : dict of int to str
        Names of models by their id.
    edit : dict, optional
        The entry of the log for it, which tells apart what the states do not.
    """
    edit = edit or {"do": ""}
    said = _edit_words(edit, name_of)
    if said:
        return said
    if before.model is not after.model:
        return f"model: {models.get(id(after.model), 'another')}"
    pulled = [v for v, t in after.pins.items() if not np.array_equal(t, before.pins.get(v))]
    if pulled and edit["do"] != "set_pin":
        twin = " and its twin" if len(pulled) == 2 else ""
        return f"pull {name_of(pulled[0])}{twin}" if len(pulled) < 3 else f"{len(pulled)} pins"
    gone = [v for v in before.pins if v not in after.pins]
    if gone and after.pins:
        return f"pin off {name_of(gone[0])}"
    for name, text in (("beta", "Regions agree β"), ("gamma", "Stay close γ")):
        if getattr(before, name) != getattr(after, name):
            return f"{text} {getattr(after, name):.3g}"
    if before.limit != after.limit:
        return "stay natural" + ("" if after.limit else " no more")
    for name, verbs in _PIN_VERBS.items():
        said = _pin_words(*(getattr(state, name) for state in (before, after)), verbs, after.pins)
        if said:
            return f"{said[0]} {name_of(said[1])}"
    if before.gaze != after.gaze and np.array_equal(before.coefficients, after.coefficients):
        return "eyes"
    if not gone and not np.array_equal(before.molded, after.molded):
        return "eyes" if _only_looks(before, after) else "slider"
    if np.array_equal(before.coefficients, after.coefficients):
        return "pins baked"
    return "another pose" if after.coefficients.any() else "reset"


def _edit_words(edit, name_of):
    """What an edit did, where its entry in the log alone says that; else None."""
    do = edit["do"]
    if do == "copy_side":
        return _SIDES[edit["side"]]
    if do == "mirror_pin":
        return f"mirror pin {name_of(edit['vertex'])}"
    if do == "set_pin" and edit.get("target") is not None:
        return f"target of {name_of(edit['vertex'])}"
    if do == "set_pin" and edit.keys() <= {"t", "do", "vertex", "target"}:
        return f"hold {name_of(edit['vertex'])}"
    return _BUTTONS.get(do)


def _only_looks(before, after):
    """Whether only look shapes of a rig were moved by hand."""
    if not after.model.named:
        return False
    looks = look_units(after.model.component_names(0)).any(axis=(0, 2))
    return not (before.molded != after.molded)[~looks].any()


def expression_step(before, after, name_of):
    """What led from one `ExpressionState` to the next."""
    for v, offset in after.pulls.items():
        if before.pulls.get(v) != offset:
            return f"pull {name_of(v)}"
    if after.sketch is not before.sketch:
        gone = [v for v in before.pulls if v not in after.pulls]
        return f"pin off {name_of(gone[0])}" if gone and after.pulls else f"sketch: {after.origin}"
    if before.alpha != after.alpha:
        return "best α" if after.alpha is None else f"α {after.alpha:g}"
    if before.locked != after.locked or before.excluded != after.excluded:
        return _units_step(before, after)
    for name, text in (("lam", "λ"), ("bounds", "weights"), ("criterion", "best by")):
        if getattr(before, name) != getattr(after, name):
            value = getattr(after, name)
            return f"{text} {value:.3g}" if name == "lam" else f"{text} {value}"
    for name in ("hidden", "called"):
        a, b = getattr(before, name), getattr(after, name)
        said = _pin_words(a, b, _PIN_VERBS[name], after.pulls)
        if said:
            return f"{said[0]} {name_of(said[1])}"
    return "setting"


def _units_step(before, after):
    for name in after.excluded - before.excluded:
        return f"leave out {name}"
    for name, weight in after.locked.items():
        if before.locked.get(name) != weight:
            return f"{name} held at {weight:.2f}"
    freed = [*(before.locked.keys() - after.locked.keys()), *(before.excluded - after.excluded)]
    return f"free {freed[0]}" if len(freed) == 1 else "free all"


_PIN_VERBS = {  # for one that is there now, and for one that is there no more
    "locked": ("lock", "unlock"), "hidden": ("hide", "show"),
    "called": ("name", "name off"), "weights": ("weight of", "weight of"),
}  # fmt: skip


def _pin_words(before, after, verbs, pins):
    """The verb and the first of the pins that two sets, or mappings, do not agree on; or None."""
    for v in pins:
        had, has = (v in x and (isinstance(x, frozenset) or x[v]) for x in (before, after))
        if had != has:
            return verbs[not has], v
    return None
