"""Tables of notebooks: sorted, aligned, never wrapped, never HTML from outside."""

import pytest

from facelab.course import Table


def test_a_table_is_sorted_by_what_matters_and_never_wraps():
    html = Table(["a", "b (mm)"], [("x", 1), ("y", 2.345)], sort="-b (mm)", digits=1)._repr_html_()
    assert html.index(">y<") < html.index(">x<") and ">2.3<" in html
    assert "nowrap" in html


def test_what_a_table_holds_is_never_html():
    assert "<b>" not in Table(["<b>"], [("<b>",)], title="<b>")._repr_html_()


@pytest.mark.parametrize(
    ("rows", "sort", "words"), [([(1,)], None, "2 values"), ([(1, 2)], "c", "no heading")]
)
def test_rows_and_headings_must_fit(rows, sort, words):
    with pytest.raises(ValueError, match=words):
        Table(["a", "b"], rows, sort=sort)
