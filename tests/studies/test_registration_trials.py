"""Names of markers are spoilt as they go wrong, each in its own way."""

from facelab.studies.registration_trials import spoilt_names

NAMES = ["brow_left_1", "chin", "brow_right_1", "jaw_left_2", "nose_tip"]


def test_every_way_spoils_the_names_and_loses_none():
    for what, names in spoilt_names(NAMES).items():
        assert names != NAMES, what
        assert len(set(names)) == len(NAMES), what


def test_what_is_exchanged_is_what_is_said():
    spoilt = spoilt_names(NAMES)
    brows = spoilt["left and right of the brows exchanged"]
    assert brows == ["brow_right_1", "chin", "brow_left_1", "jaw_left_2", "nose_tip"]
    assert spoilt["left and right of all exchanged"][3] == "jaw_right_2"
    assert spoilt["chin and nose exchanged"][1::3] == ["nose_tip", "chin"]
    assert spoilt["all shifted by one"] == [*NAMES[1:], NAMES[0]]
