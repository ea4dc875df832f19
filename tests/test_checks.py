"""What the checks at the boundary say: the parameter, what was given, and what is wanted."""

import numpy as np
import pytest

from facelab.checks import as_finite, check_choice, check_count, check_number, check_type


@pytest.mark.parametrize("given", ["abc", [[1, 2, 3], [4, 5]], {"a": 1}, object(), [None, "x"]])
def test_what_makes_no_array_is_named_with_the_shape_wanted(given):
    kind = type(given).__name__
    message = rf"^target in face\.obj is a {kind} that makes .* shape \(n, 3\)\.$"
    with pytest.raises(TypeError, match=message) as caught:
        as_finite(given, "target", ("n", 3), "face.obj")
    assert "could not convert" not in str(caught.value) and caught.value.__cause__ is None


@pytest.mark.parametrize("wanted, said", [((3,), r"\(3,\)"), (("n", 3), r"\(n, 3\)")])
def test_an_array_of_another_shape_is_named_with_both_shapes(wanted, said):
    with pytest.raises(ValueError, match=rf"V has shape \(2, 4\), but needs shape {said}"):
        as_finite(np.zeros((2, 4)), "V", wanted)


def test_a_value_of_the_type_goes_through_and_any_other_is_named_with_the_remedy():
    assert check_type(3, "n", int, "count") == 3
    assert check_type("a", "n", (int, str), "count") == "a"
    with pytest.raises(TypeError, match="n is a float, but must be of type int or str; count them"):
        check_type(3.0, "n", (int, str), "count them")


@pytest.mark.parametrize("value", [1, 4, np.int64(4)])
def test_a_count_within_its_limits_is_an_int(value):
    count = check_count(value, "n", 1, 4, "clusters")
    assert type(count) is int and count == value
    assert check_count(10**9, "n", 1, None, "clusters") == 10**9


@pytest.mark.parametrize("value", [0, 5, -1])
def test_a_count_beyond_its_limits_is_refused_with_them(value):
    with pytest.raises(ValueError, match=f"n={value}, but the number of clusters must be 1 to 4"):
        check_count(value, "n", 1, 4, "clusters")
    with pytest.raises(ValueError, match="n=0, but the number of clusters must be 1 or more"):
        check_count(0, "n", 1, None, "clusters")


@pytest.mark.parametrize("value", [2.0, "2", True, None, np.array([2])])
def test_a_count_that_is_no_integer_is_refused(value):
    with pytest.raises(TypeError, match="is not an integer: give the number of clusters"):
        check_count(value, "n", 1, 4, "clusters")


def test_a_choice_is_the_one_it_equals():
    assert check_choice(np.False_, "align", ("check", True, False)) is False
    assert check_choice(1, "align", ("check", True, False)) is True


@pytest.mark.parametrize("value", ["maybe", None, np.array([True, False]), ["check"], {}])
def test_what_is_no_choice_is_refused_with_the_choices(value):
    with pytest.raises(ValueError, match="is unknown; choose one of 'check', True, False"):
        check_choice(value, "align", ("check", True, False))


@pytest.mark.parametrize(
    "given", ["0.25", b"1", True, np.True_, 1j, None, [1.0], object(), np.array("1")]
)
def test_what_only_looks_like_a_number_is_none(given):
    with pytest.raises(TypeError, match=r"weight=.* is not a number"):
        check_number(given, "weight")


@pytest.mark.parametrize(
    "given", [["1", 2], [True, 0.5], [[1.0, 2], [3, False]], np.array([True]), np.array(["1"]), 1j]
)
def test_an_array_of_what_only_looks_like_numbers_is_none(given):
    with pytest.raises(TypeError, match=r"V is a .* that makes no array of numbers"):
        as_finite(given, "V", ("n",))


def test_an_integer_beyond_all_floats_is_refused():
    with pytest.raises(ValueError, match="lam is an integer beyond all floats"):
        check_number(10**400, "lam")
    with pytest.raises(ValueError, match="V holds an integer beyond all floats"):
        as_finite([1.0, 10**400], "V", (2,))


@pytest.mark.parametrize("given", [np.inf, -np.inf, np.nan])
def test_a_number_that_is_not_finite_is_told_to_be_finite(given):
    with pytest.raises(ValueError, match=r"limit=.*, but it must be finite and more than 0"):
        check_number(given, "limit", above=0)
    with pytest.raises(ValueError, match=r"limit=.*, but it must be finite[.]"):
        check_number(given, "limit")
