"""docs/scale.md shows what its benchmark measured, and nothing else."""

import copy
import importlib.util
import json

import pytest
from environment import ROOT

pytest.importorskip("resource", reason="the benchmark measures memory as Unix does")


@pytest.fixture(scope="module")
def bench():
    spec = importlib.util.spec_from_file_location("bench", ROOT / "tests/benchmarks/scale.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def found():
    return json.loads((ROOT / "docs" / "scale.json").read_text(encoding="utf-8"))


def test_the_tables_of_the_page_are_those_of_the_numbers_that_were_measured(bench, found):
    text = (ROOT / "docs" / "scale.md").read_text(encoding="utf-8")
    assert bench.page(text, found) == text


def test_a_number_that_was_not_measured_is_not_on_the_page(bench, found):
    other = copy.deepcopy(found)
    other["takes"]["workers"]["2"][0] *= 2
    text = bench.page((ROOT / "docs" / "scale.md").read_text(encoding="utf-8"), other)
    assert bench.page(text, other) == text != bench.page(text, found)


def test_memory_does_not_grow_with_the_frames(found):
    rows = {r["frames"]: r for r in found["learning"]["rows"] if r["workers"] == 2}
    assert sorted(rows) == [10**4, 10**5, 10**6]
    for who in ("worker", "asks"):
        assert rows[10**6][who] < 1.2 * rows[10**4][who]


def test_more_frames_on_paper_take_more_time_and_as_much_work(bench, found):
    head, *rows = [r.split("|")[1:-1] for r in bench.on_paper(2.0, 1e-3, found["learning"])[-3:]]
    assert set("".join(head)) <= set("-:")
    hours = [float(row[-1]) for row in rows]
    assert hours[1] == pytest.approx(10 * hours[0], rel=0.05)
    takes = bench.on_paper(2.0, 1e-3, found["learning"])[4:8]
    assert [r.split("|")[2].strip() for r in takes] == ["2,880,000", "3,600,000", "2,000", "0.56"]
