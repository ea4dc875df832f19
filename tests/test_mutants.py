import numpy as np
import pytest
from mutants import BINARY, BYTES, TEXT, mutants, tally, verdict

import facelab.storage

TABLE = b"frame,fps,a,b\n0,30.0,0.5,0.25\n1,30.0,0.75,-0.5\n2,30.0,0.1,0.2\n"


def test_mutants_follow_from_the_seed_and_none_is_the_file():
    first = list(mutants(TABLE, 400, np.random.default_rng(1)))
    again = list(mutants(TABLE, 400, np.random.default_rng(1)))
    assert first == again
    assert all(data != TABLE for _, data in first)
    assert {kind for kind, _ in first} == {*BYTES, *TEXT}


def test_binary_files_are_damaged_as_binary():
    kinds = {kind for kind, _ in mutants(bytes(range(256)), 400, np.random.default_rng(1))}
    assert kinds == {*BYTES, *BINARY}


@pytest.mark.parametrize("data", [b"", b"a", b"\n", b"\0"])
def test_the_smallest_files_have_mutants_too(data):
    if not data:
        data = b" "
    assert len(list(mutants(data, 20, np.random.default_rng(1)))) == 20


def test_a_refusal_counts_only_in_our_words(tmp_path):
    def ours(path):
        facelab.storage.existing_file(path, "table")

    def names_no_file(path):
        raise ValueError("something is wrong")

    def python_inside(path):
        float("abc")

    path = tmp_path / "a.csv"
    assert verdict(ours, b"", path).kind == "refused"
    assert verdict(names_no_file, b"x", path).kind == "python"
    assert verdict(python_inside, b"x", path).kind == "python"
    assert verdict(lambda p: 3, b"x", path).result == 3


def test_what_contradicts_the_file_is_counted_as_wrong(tmp_path):
    found = tally(
        lambda p: len(p.read_bytes()),
        TABLE,
        "a.csv",
        tmp_path,
        50,
        np.random.default_rng(1),
        lambda size, data, said: "" if size == len(TABLE) else "another size",
    )
    assert found.counts["wrong"] == len(found.wrong) > 0
    assert found.counts["wrong"] + found.counts["accepted"] == 50
