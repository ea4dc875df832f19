import doctest

import pytest

from facelab import motion, names
from facelab.names import ANGLES, ARKIT, arkit_names, canonical, match_names, normalised


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


@pytest.mark.parametrize(
    "spell",
    ["{name}.001", "{k:02d}_{name}", "shape.{k}_{name}", "A{k:02d}_{name}", "ARKit_{k:02d}_{name}"],
    ids=["copy", "number", "both", "letter", "prefix"],
)
def test_numbers_of_copies_and_in_front_are_seen_through(spell):
    shapes = [spell.format(k=k, name=name) for k, name in enumerate(ARKIT)]
    found = match_names(shapes, ARKIT)
    assert found.driven == dict(zip(shapes, ARKIT, strict=True))


def test_numbers_that_are_names_stay():
    found = match_names(["AU_01", "AU_02_L", "AU_12_L"], ["AU01", "AU02L", "AU12L"])
    assert list(found.driven.values()) == ["AU01", "AU02L", "AU12L"]
    assert match_names(["1_L", "2_L", "3_L"], ["2_L", "4_L"]).driven == {"2_L": "2_L"}


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
        ("lipCornerPuller_L", ("mouthSmileLeft",)),
        ("Inner Brow Raiser", ("browInnerUp",)),
        ("eyesClosed_R", ("eyeBlinkRight",)),
        ("jawSidewaysLeft", ("jawLeft",)),
        ("jawDrop", ("jawOpen",)),
        ("mouthStretch_L", ("mouthStretchLeft",)),  # ARKit's own before that of FACS
        ("nostrilDilator_L", ()),
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


# --- two lists of names ---------------------------------------------------------------------------

SPELLINGS = {
    "as it is": str,
    "Pascal": lambda n: n[0].upper() + n[1:],
    "snake": lambda n: "".join(f"_{c.lower()}" if c.isupper() else c for c in n),
    "namespace": lambda n: f"blendShape1.{n}",
    "prefix": lambda n: f"head_{n}",
    "longer prefix": lambda n: f"CC_Base_{n}",
    "_L": lambda n: n.replace("Left", "_L").replace("Right", "_R"),
    ".l": lambda n: n.replace("Left", ".l").replace("Right", ".r"),
    "l_": lambda n: (n[-5:] == "Right") * "r_" + (n[-4:] == "Left") * "l_" + _plain(n),
    "mixed": lambda n: f"Head_GEO.{n.upper()}" if n.startswith("jaw") else n,
}


def _plain(name):
    return name.removesuffix("Left").removesuffix("Right")


@pytest.mark.parametrize("spell", SPELLINGS)
@pytest.mark.parametrize("there", ["as it is", "prefix", "l_"])
def test_every_spelling_of_a_rig_is_driven_whole_by_every_other(spell, there):
    shapes = [SPELLINGS[spell](n) for n in ARKIT]
    names = [SPELLINGS[there](n) for n in ARKIT]
    match = match_names(shapes, names)
    assert match.driven == dict(zip(shapes, names, strict=True))
    assert match.idle == match.left_over == ()


def test_a_name_with_a_side_never_stands_for_the_other_and_a_bare_jaw_for_none():
    match = match_names(["eyeBlink_L", "eyeBlink_R"], ["eyeBlinkLeft"])
    assert match.driven == {"eyeBlink_L": "eyeBlinkLeft"} and match.idle == ("eyeBlink_R",)
    assert not match_names(["jawLeft", "mouthRight"], ["jaw", "mouth"]).driven


def test_left_and_top_is_not_left():
    names = ["lipFunneler_LT", "lipFunneler_LB", "lipFunneler_RT", "lipFunneler_RB"]
    assert not match_names(["lipFunneler_L", "lipFunneler_R"], names).driven
    assert match_names(names, [n.lower() for n in names]).idle == ()


def test_two_sides_in_a_name_are_kept_apart():
    names = ["eyesLookLeft_L", "eyesLookLeft_R", "eyesLookRight_L", "eyesLookRight_R"]
    spelled = ["L_eyesLookLeft", "EyesLookLeftRight", "eyesLookRight.l", "eyes_look_right_r"]
    assert match_names(names, spelled).driven == dict(zip(names, spelled, strict=True))


def test_what_reads_like_two_is_refused_by_name():
    with pytest.raises(ValueError, match=r"'a\.jawOpen', 'b\.jawOpen' all read .* 'JawOpen'"):
        match_names(["JawOpen"], ["a.jawOpen", "b.jawOpen"])
    with pytest.raises(ValueError, match=r"shapes 'Jaw_Open', 'JAWOPEN' all read like 'jawOpen'"):
        match_names(["Jaw_Open", "JAWOPEN"], ["jawOpen"])
    match = match_names(["jawOpen", "Jaw_Open"], ["jawOpen", "JAWOPEN", "jaw open"][:1])
    assert match.driven == {"jawOpen": "jawOpen"} and match.idle == ("Jaw_Open",)


def test_a_prefix_that_few_names_have_is_part_of_them():
    assert not match_names(["upperLid"], ["lid", "jaw"]).driven
    assert not match_names(["upperLid", "lower", "chin", "nose"], ["lid"]).driven


def test_a_report_says_all_names_once():
    match = match_names(["a_L", "a_R", "b", "c"], ["A", "b", "d"])
    assert repr(match) == "NameMatch(3 of 4 shapes driven by 2 of 3 names)"
    assert str(match).splitlines()[1:] == [
        "In another spelling: a_L and a_R by A.",
        "Not driven: c.",
        "Left over: d.",
    ]


def test_names_without_a_letter_drive_nothing():
    assert match_names(["!", "?"], ["", "..."]).driven == {}
