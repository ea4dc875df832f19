"""Kept folders: sealed whole, checked whole, made again in doubt, by any number of processes."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import facelab
from facelab import keeping
from facelab.data import cache
from facelab.keeping import build, fault, keep, keep_arrays, source_stamp

KEY = {"code": "abc", "fps": 60}


def write(folder):
    (folder / "one").write_text("first")
    (folder / "two").write_bytes(bytes(1000))


def read(folder):
    return (folder / "one").read_text()


def refuse(folder):
    pytest.fail(f"{folder} made again")


@pytest.fixture
def kept(tmp_path):
    assert keep(tmp_path / "kept", KEY, write, read) == "first"
    return tmp_path / "kept"


def test_what_is_whole_is_only_read(kept):
    assert keep(kept, KEY, refuse, read) == "first"
    assert fault(kept) is None and fault(kept, KEY) is None
    assert [f.name for f in kept.parent.iterdir()] == ["kept"]


def test_another_key_makes_it_again(kept):
    assert fault(kept, {"fps": 30}) == "it was made with another fps"
    keep(kept, {**KEY, "fps": 30}, lambda folder: (folder / "one").write_text("second"), read)
    assert read(kept) == "second" and not (kept / "two").exists()


def edit(**entries):
    def damage(kept):
        manifest = json.loads((kept / keeping.MANIFEST).read_text())
        (kept / keeping.MANIFEST).write_text(json.dumps({**manifest, **entries}))

    return damage


def manifest_text(text):
    return lambda kept: (kept / keeping.MANIFEST).write_text(text)


DAMAGE = {
    "one is damaged": lambda kept: (kept / "one").write_text("fIrst"),
    "two is damaged": lambda kept: (kept / "two").write_bytes(bytes(999)),
    "one is missing": lambda kept: (kept / "one").unlink(),
    "no manifest": lambda kept: (kept / keeping.MANIFEST).unlink(),
    "manifest is damaged (no files)": edit(files={}),
    "manifest is damaged (another key)": edit(key={"fps": 30}),
    "manifest is damaged (no seal)": edit(seal=None),
    "manifest is damaged (empty)": manifest_text(""),
    "manifest is damaged (no entry)": manifest_text("{}"),
    "manifest is damaged (a list)": manifest_text("[1, 2]"),
    "manifest is damaged (deep)": manifest_text("[" * 100_000),
}


@pytest.mark.parametrize("words, damage", DAMAGE.items(), ids=list(DAMAGE))
def test_whatever_is_not_as_it_was_sealed_is_made_again(kept, words, damage):
    damage(kept)
    assert words.partition(" (")[0] in fault(kept)
    assert keep(kept, KEY, write, read) == "first"
    assert fault(kept, KEY) is None
    assert [f.name for f in kept.parent.iterdir()] == ["kept"]


def test_a_file_or_a_dead_link_in_its_place_gives_way(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for name in ("file", "link"):
        assert keep(tmp_path / name, KEY, write, read) == "first"


def test_what_fails_leaves_what_was_there(kept):
    (kept / "one").unlink()

    def fail(folder):
        write(folder)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        keep(kept, KEY, fail, read)
    assert [f.name for f in kept.parent.iterdir()] == ["kept"] and (kept / "two").exists()


def test_the_loser_of_a_race_takes_what_the_winner_made(tmp_path):
    def slow(folder):
        write(folder)
        keep(tmp_path / "kept", KEY, lambda other: (other / "one").write_text("faster"), read)

    assert keep(tmp_path / "kept", KEY, slow, read) == "faster"
    assert [f.name for f in tmp_path.iterdir()] == ["kept"]


def test_a_folder_of_ones_own_is_never_written_over(tmp_path):
    (tmp_path / "mine").mkdir()
    build(tmp_path / "mine", KEY, write)
    assert fault(tmp_path / "mine", KEY) is None
    with pytest.raises(FileExistsError, match="mine' holds something already"):
        build(tmp_path / "mine", KEY, refuse)


def test_arrays_are_kept_and_given_back(tmp_path, monkeypatch):
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))
    first = keep_arrays("room/a", KEY, lambda: {"x": np.arange(3.0), "names": ["a", "b"]})
    again = keep_arrays("room/a", KEY, lambda: pytest.fail("made again"))
    for found in (first, again):
        np.testing.assert_array_equal(found["x"], [0, 1, 2])
        assert found["names"].tolist() == ["a", "b"]


# --- a cache that cannot be written ---------------------------------------------------------------


@pytest.fixture
def read_only(tmp_path, monkeypatch):
    """A cache with one good folder, in which nothing new can be written."""
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))
    keep_arrays("room/old", KEY, lambda: {"x": [1]})
    temporary = tempfile.TemporaryFile

    def refused(*, dir):
        if dir.is_relative_to(tmp_path):
            raise PermissionError(13, "Permission denied")
        return temporary(dir=dir)

    monkeypatch.setattr(keeping.tempfile, "TemporaryFile", refused)
    return tmp_path


def test_a_read_only_cache_is_read_and_what_it_lacks_is_made_elsewhere(read_only, recwarn):
    assert keep_arrays("room/old", KEY, lambda: pytest.fail("made again"))["x"] == 1
    assert not recwarn
    with pytest.warns(UserWarning, match=r"room cannot be written \(Permission denied\)"):
        assert keep_arrays("room/new", KEY, lambda: {"x": [2]})["x"] == 2
    with pytest.warns(UserWarning):
        assert keep_arrays("room/new", KEY, lambda: pytest.fail("made again"))["x"] == 2
    assert [f.name for f in (read_only / "room").iterdir()] == ["old"]


def test_a_cache_that_cannot_even_be_made_stops_nobody(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.warns(UserWarning, match="cannot be written"):
        assert keep_arrays("room/other", KEY, lambda: {"x": [3]})["x"] == 3


def test_downloads_go_elsewhere_too(read_only, monkeypatch):
    """The folder is asked for before the network is."""
    folders = []

    def retrieve(url, known_hash, fname, path, progressbar):
        folders.append(path)
        return path / fname

    monkeypatch.setattr(cache.pooch, "retrieve", retrieve)
    with pytest.warns(UserWarning, match="captures cannot be written"):
        cache.download("https://example.org/", "a.csv", "00", read_only / "captures")
    assert not folders[0].is_relative_to(read_only)


def test_where_there_are_no_locks_the_faster_of_two_makers_is_read(tmp_path, monkeypatch):
    rename, mine = Path.rename, []

    def late(part, folder):  # another process has put its own there meanwhile
        mine.append(part)
        monkeypatch.setattr(Path, "rename", rename)
        keep(folder, KEY, write, read)
        raise FileExistsError(17, "as Windows has it")

    monkeypatch.setattr(keeping, "fcntl", None)
    monkeypatch.setattr(Path, "rename", late)
    assert keep(tmp_path / "kept", KEY, write, read) == "first" and mine
    assert [f.name for f in tmp_path.iterdir()] == ["kept"] and fault(tmp_path / "kept") is None


# --- several processes ----------------------------------------------------------------------------

CHILD = """
import sys, types
from pathlib import Path

sys.modules["facelab"] = types.ModuleType("facelab")  # without all that it takes long to import
sys.modules["facelab"].__path__ = [str(Path(sys.argv[1], "facelab"))]

from facelab.keeping import keep

stepwise = sys.argv[3] == "stepwise"

def write(part):
    for name in "abcde":
        (part / name).write_bytes(bytes(100_000))
        if stepwise:
            print("wrote", name, flush=True)
            sys.stdin.readline()

def read(folder):
    return sum((folder / name).stat().st_size for name in "abcde")

print("ready", flush=True)
while sys.stdin.readline():
    try:
        print(keep(Path(sys.argv[2]), {"key": 1}, write, read), flush=True)
    except Exception as error:
        print(type(error).__name__, error, flush=True)
"""


class Child(subprocess.Popen):
    """A process that opens a kept folder at each line it is sent."""

    def __init__(self, folder, how):
        root = Path(facelab.__file__).parents[1]
        super().__init__(
            [sys.executable, "-c", CHILD, str(root), str(folder), how],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )

    def tell(self):
        self.stdin.write("go on\n")

    def answer(self):
        return self.stdout.readline().strip()


@pytest.fixture
def children(tmp_path):
    """Starts processes that all open the same folder."""
    started = []

    def start(n, how):
        started.extend(Child(tmp_path / "kept", how) for _ in range(n))
        assert [child.answer() for child in started] == ["ready"] * n
        return started

    yield start
    for child in started:
        child.kill()
        child.communicate()


def test_two_processes_that_find_the_same_damage_both_come_through(children, tmp_path):
    pair, damages = children(2, "at once"), ("a", "c", keeping.MANIFEST)
    for i in range(21):
        if i:
            (tmp_path / "kept" / damages[i % 3]).write_text("damaged")
        for child in pair:
            child.tell()
        assert [child.answer() for child in pair] == ["500000"] * 2
    assert [f.name for f in tmp_path.iterdir()] == ["kept"]


@pytest.mark.skipif(keeping.fcntl is None, reason="without locks, left-overs go by their age")
def test_killed_makers_leave_nothing_that_is_taken_for_whole_or_that_stays(children, tmp_path):
    *dying, last = makers = children(4, "stepwise")
    for maker in makers:
        maker.tell()
        assert maker.answer() == "wrote a"
    for n_more, maker in enumerate(dying):
        for name in "bcde"[: 2 * n_more]:
            maker.tell()
            assert maker.answer() == f"wrote {name}"
        maker.kill()
        maker.wait()
    assert not (tmp_path / "kept").exists()
    assert len(list(tmp_path.iterdir())) == 4
    keep(tmp_path / "other", KEY, write, read)
    assert len(list(tmp_path.glob(".*.part"))) == 1  # the last one is left in peace
    for _ in "abcde":
        last.tell()
    assert [last.answer() for _ in range(5)] == [*(f"wrote {name}" for name in "bcde"), "500000"]
    assert sorted(f.name for f in tmp_path.iterdir()) == ["kept", "other"]


def test_without_locks_left_overs_are_swept_when_they_are_old(tmp_path, monkeypatch):
    monkeypatch.setattr(keeping, "fcntl", None)
    for name in ("old", "young"):
        (tmp_path / f".{name}.part").mkdir()
    os.utime(tmp_path / ".old.part", (0, 0))
    keep(tmp_path / "kept", KEY, write, read)
    assert sorted(f.name for f in tmp_path.iterdir()) == [".young.part", "kept"]


# --- the code that something hangs on -------------------------------------------------------------

FILES = {
    "facelab/__init__.py": "import facelab.page\n",
    "facelab/page.py": "",
    "facelab/checks.py": "",
    "facelab/room/__init__.py": "from facelab.room.inner import f\n",
    "facelab/room/inner.py": "from . import beside\ndef f():\n    from facelab import checks\n",
    "facelab/room/beside.py": "import numpy\n",
    "facelab/other.py": "",
    "facelab/user.py": "import json\nfrom facelab.room import f\n",
}


@pytest.fixture
def house(tmp_path, monkeypatch):
    """A package of ours, made of a few files; gives a function that stamps it afresh."""
    for name, source in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source)
        os.utime(path, (1e9, 1e9))
    found = type("Spec", (), {"submodule_search_locations": [str(tmp_path / "facelab")]})
    monkeypatch.setattr(keeping.importlib.util, "find_spec", lambda name: found)

    def stamp(*modules):
        keeping._read.cache_clear()
        keeping._file.cache_clear()
        return source_stamp(*modules)

    yield tmp_path, stamp
    keeping._read.cache_clear()
    keeping._file.cache_clear()


def change(path):
    path.write_text(path.read_text() + "# another line\n")
    os.utime(path, (1e9, 1e9))


@pytest.mark.parametrize(
    "file, matters",
    [
        ("user.py", True),
        ("room/__init__.py", True),
        ("room/inner.py", True),
        ("room/beside.py", True),  # a relative import
        ("checks.py", True),  # an import within a function
        ("other.py", False),
        ("__init__.py", False),  # it runs, but nothing is taken from it
        ("page.py", False),
    ],
)
def test_a_stamp_hangs_on_all_that_is_imported_and_on_nothing_else(house, file, matters):
    folder, stamp = house
    before = stamp("facelab.user")
    assert stamp("facelab.user") == before
    change(folder / "facelab" / file)
    assert (stamp("facelab.user") != before) is matters


def test_code_that_was_edited_since_it_was_imported_has_a_stamp_of_its_own(house):
    folder, stamp = house
    os.utime(folder / "facelab" / "checks.py")
    assert stamp("facelab.user") != stamp("facelab.user")
    assert stamp("facelab.other") == stamp("facelab.other")


def test_what_makes_the_actors_is_all_in_the_stamp_of_their_captures():
    source_stamp("data_synth.capture")
    seen, waiting = set(), ["data_synth.capture"]
    while waiting:
        name = waiting.pop()
        seen.add(name)
        waiting += set(keeping._read(name)[1]) - seen
    wanted = {"data_synth.template.surface", "data_synth.muscles", "data_synth.actors"}
    wanted |= {"data_synth.performance.speech", "facelab.files.markers.c3d"}
    wanted |= {"facelab.geometry.mesh"}
    assert wanted <= seen
    assert not any(name.startswith("facelab.widgets") for name in seen)
