"""What the course says of its own length: one table, which the first notebook repeats."""

from reader import NOTEBOOKS, lesson_of, read
from seconds import PAGE, in_page, in_start

from facelab.course.lesson import LESSONS


def test_every_notebook_s_seconds_are_told_and_the_first_page_tells_the_same():
    told = in_page(PAGE.read_text(encoding="utf-8"))
    assert sorted(told) == [name[:2] for name in NOTEBOOKS]
    assert min(told.values()) > 0
    course = [name[:2] for name in NOTEBOOKS if lesson_of(name) in LESSONS]
    assert in_start(read("00_start")) == {number: told[number] for number in course}
