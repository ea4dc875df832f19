"""Names that stood at the top level before there were rooms."""

import pytest

import facelab


@pytest.mark.parametrize("name", ["read_obj", "write_glb", "read_c3d", "rest_markers", "Clip"])
def test_a_name_of_before_is_found_in_its_room_with_a_word(name):
    with pytest.warns(DeprecationWarning, match=rf"facelab.{name} is now facelab\.\w+\.{name}"):
        assert getattr(facelab, name).__name__ == name


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="facelab has no 'nonsense'"):
        _ = facelab.nonsense
    assert not hasattr(facelab, "_private")
