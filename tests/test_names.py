import doctest

import pytest

from facelab import motion, names
from facelab.names import ANGLES, ARKIT, arkit_names, canonical, normalised


def test_every_arkit_name_and_angle_has_a_key_of_its_own():
    assert len({normalised(n) for n in (*ARKIT, *ANGLES)}) == 61


@pytest.mark.parametrize("name", (*ARKIT, *ANGLES))
@pytest.mark.parametrize(
    "spell",
    [
        str,
        str.lower,
        str.upper,
        lambda n: n[0].upper() + n[1:],
        lambda n: n[0].lower() + n[1:],
        lambda n: "".join(f"_{c}" if c.isupper() else c for c in n).strip("_").upper(),
        lambda n: "head_GEO." + n,
        lambda n: "Character1:Body|" + n,
        lambda n: "blendShapes." + n[0].upper() + n[1:],
    ],
    ids=["own", "lower", "UPPER", "Pascal", "camel", "SNAKE", "Maya", "path", "Audio2Face"],
)
def test_the_spelling_of_a_name_does_not_matter(name, spell):
    assert canonical(spell(name)) == name


@pytest.mark.parametrize("side, spellings", [("Left", "L l Left LEFT"), ("Right", "R r right")])
@pytest.mark.parametrize("join", ["_", ".", "-", " "])
def test_a_side_is_seen_in_every_spelling_and_place(side, spellings, join):
    for s in spellings.split():
        assert canonical(f"mouthSmile{join}{s}") == f"mouthSmile{side}"
        assert canonical(f"head_GEO.mouthSmile{join}{s}") == f"mouthSmile{side}"
        if join != ".":  # in front of a point stands a namespace
            assert canonical(f"{s}{join}mouthSmile") == f"mouthSmile{side}"


@pytest.mark.parametrize("name", ["", "L", "_neutral", "Happy", "jaw", "eyeBlink", "mouthSmileLef"])
def test_other_names_are_none_of_arkits(name):
    assert canonical(name) is None


def test_letters_of_every_alphabet_stay():
    assert normalised("Brauenrücken_L") == "brauenrückenleft"
    assert normalised("眉_L") != normalised("口_L")


@pytest.mark.parametrize(
    "name, expected",
    [
        ("jawOpen", ("jawOpen",)),
        ("JawOpen", ("jawOpen",)),
        ("head.mouthSmile_L", ("mouthSmileLeft",)),
        ("mouthSmile_L", ("mouthSmileLeft",)),
        ("browInnerUp_R", ("browInnerUp",)),
        ("mouthLeft", ("mouthLeft",)),
        ("AU12R", ("mouthSmileRight",)),
        ("AU4", ("browDownLeft", "browDownRight")),
        ("AU1", ("browInnerUp",)),
        ("AU28", ("mouthRollLower", "mouthRollUpper")),
        ("AU30L", ("jawLeft",)),
        ("AU30", ()),
        ("jaw", ()),
        ("mouth", ()),
        ("AU35", ()),
        ("AU11L", ()),
        ("AU28L", ()),
        ("mouth_L", ("mouthLeft",)),
        ("HeadYaw", ()),
        ("bulge", ()),
    ],
)
def test_a_unit_finds_its_name_in_arkit(name, expected):
    assert arkit_names(name) == expected


@pytest.mark.real
def test_every_shape_of_the_generic_face_has_a_name_and_only_the_tongue_is_left(real_rig):
    found = [arkit_names(n) for n in real_rig.names]
    assert all(found)
    assert {*ARKIT} - {t for f in found for t in f} == {"tongueOut"}


def test_the_units_of_the_actors_go_where_their_table_says():
    from data_synth.units import UNIT_TABLE

    for unit in UNIT_TABLE.values():
        found = arkit_names(unit.name)
        assert {*found} <= {t for i in unit.ict for t in arkit_names(i)}, unit.name
        assert found or unit.name in ("AU11L", "AU11R", "AU13", "AU23", "AU25", "AU35", "AU38")


@pytest.mark.parametrize("module", [names, motion], ids=lambda module: module.__name__)
def test_the_examples_run(module):
    failed, tried = doctest.testmod(module)
    assert tried and not failed
