"""Files are written whole or not at all, and hostile npz files take neither memory nor effect."""

import io
import multiprocessing
import os
import random
import resource
import stat
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest
from planted import bumpy_rig

from facelab import storage
from facelab.files import gltf, poses
from facelab.posing.clips import Clip
from facelab.posing.session import PosingSession
from facelab.storage import atomic_path, check_writable, existing_file, load_npz, open_npz, save_npz
from facelab.studies import generalisation
from facelab.widgets.posing_lab import PosingLab

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="asks the Linux kernel")
POSIX = pytest.mark.skipif(os.name != "posix", reason="asks a POSIX file system")


def write(path, text="new"):
    with atomic_path(path) as part:
        part.write_text(text)


def names(folder):
    return sorted(p.name for p in folder.iterdir())


# --- modes and links ------------------------------------------------------------------------------


@POSIX
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664, 0o755])
def test_a_file_keeps_its_mode_when_it_is_written_anew(tmp_path, mode):
    path = tmp_path / "pose.json"
    path.write_text("old")
    path.chmod(mode)
    write(path)
    assert path.read_text() == "new"
    assert stat.S_IMODE(path.stat().st_mode) == mode


@POSIX
@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_a_new_file_has_the_mode_of_any_new_file(tmp_path, umask):
    before = os.umask(umask)
    try:
        write(tmp_path / "pose.json")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "pose.json").stat().st_mode) == 0o666 & ~umask


@POSIX
@pytest.mark.parametrize("there", [True, False], ids=["to a file", "to nothing yet"])
def test_a_symbolic_link_stays_one_and_what_it_points_to_is_written(tmp_path, there):
    (tmp_path / "elsewhere").mkdir()
    real, link = tmp_path / "elsewhere" / "real.json", tmp_path / "pose.json"
    if there:
        real.write_text("old")
        real.chmod(0o600)
    link.symlink_to(real)
    write(link)
    assert link.is_symlink() and real.read_text() == "new" and not real.is_symlink()
    assert names(tmp_path) == ["elsewhere", "pose.json"] and names(real.parent) == ["real.json"]
    if there:
        assert stat.S_IMODE(real.stat().st_mode) == 0o600


# --- what killed writers leave --------------------------------------------------------------------


def test_what_killed_writers_left_is_swept_and_work_under_way_is_not(tmp_path):
    with atomic_path(tmp_path / "a.json") as lost, atomic_path(tmp_path / "b.json") as young:
        lost.write_text("half of")
        young.write_text("half of")
        os.utime(lost, (time.time() - 7200,) * 2)
        (tmp_path / "mine.json").write_text("old")
        os.utime(tmp_path / "mine.json", (1, 1))
        write(tmp_path / "c.json")
        assert not lost.exists() and young.exists()
        lost.write_text("again")  # so that the writer above can end
    assert names(tmp_path) == ["a.json", "b.json", "c.json", "mine.json"]


def test_unfinished_poses_are_never_offered(tmp_path):
    rig = bumpy_rig()
    with atomic_path(tmp_path / "smile.json") as part:
        part.write_text("{}")
        (tmp_path / ".frown.json.ab12cd.json").write_text("{}")  # as they were once called
        (tmp_path / "frown.json").write_text("{}")
        lab = PosingLab(PosingSession(rig, rig.neutral), folder=tmp_path)
    assert list(lab.files.name.options) == ["frown"]


# --- paths that cannot be written -----------------------------------------------------------------


def refused_paths(tmp_path):
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "file").write_text("x")
    (tmp_path / "loop.json").symlink_to(tmp_path / "loop.json")
    os.mkfifo(tmp_path / "pipe.json")
    return {
        "folder": (tmp_path / "folder.json", ValueError, "is a folder; add the name of a file"),
        "no folder": (tmp_path / "file" / "a.json", FileNotFoundError, "file is not a folder"),
        "missing": (tmp_path / "no" / "a.json", FileNotFoundError, "no does not exist"),
        "long": (tmp_path / ("é" * 140 + ".json"), ValueError, "name of 285 bytes is too long"),
        "loop": (tmp_path / "loop.json", ValueError, "leads back to itself"),
        "pipe": (tmp_path / "pipe.json", ValueError, "is not a file"),
        "nul": (f"{tmp_path}/a\0.json", ValueError, "cannot be the name of a file"),
        "number": (7, TypeError, "path is a int"),
        "sealed": ("/proc/a.json", PermissionError, "/proc cannot be written to"),
    }


@LINUX
@pytest.mark.parametrize(
    "name", ["folder", "no folder", "missing", "long", "loop", "pipe", "nul", "number", "sealed"]
)
def test_a_path_that_cannot_be_written_is_refused_at_once(tmp_path, name):
    path, error, message = refused_paths(tmp_path)[name]
    before = names(tmp_path)
    for refuse in (check_writable, lambda path: atomic_path(path).__enter__()):
        with pytest.raises(error, match=message):
            refuse(path)
    assert names(tmp_path) == before


@pytest.mark.parametrize("ending", [".glb", ".clip.glb", ".json", ".csv"])
def test_writers_refuse_a_bad_path_before_they_work(tmp_path, monkeypatch, ending):
    def at_work(*_):
        raise AssertionError("the work had begun")

    for module, work in ((gltf, "_File"), (poses, "fingerprint"), (generalisation, "load_actors")):
        monkeypatch.setattr(module, work, at_work)
    rig = bumpy_rig()
    session = PosingSession(rig, rig.neutral)
    monkeypatch.setattr(session, "vertices_of", at_work)
    (tmp_path / "generalisation.csv").mkdir()
    path = tmp_path / ("a" * 300 + ending)
    write = {
        ".glb": lambda: gltf.write_glb(path, rig.neutral),
        ".clip.glb": lambda: gltf.write_clip_glb(path, Clip([0.0], [np.zeros(12)]), session),
        ".json": lambda: poses.save_pose(path, session),
        ".csv": lambda: generalisation.main(["--out", str(tmp_path)]),
    }[ending]
    with pytest.raises(ValueError, match=r"too long for the file system|is a folder; add"):
        write()


@POSIX
def test_write_protected_files_and_folders_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "pose.json"
    path.write_text("old")
    monkeypatch.setattr(storage.os, "access", lambda p, how: how != os.W_OK)  # root may all
    with pytest.raises(PermissionError, match="write-protected; choose another name"):
        write(path)
    assert path.read_text() == "old"


@pytest.mark.parametrize("size", [1, 255])
def test_names_as_long_as_the_file_system_allows_are_written(tmp_path, size):
    path = tmp_path / ("a" * size)
    write(path)
    assert path.read_text() == "new" and names(tmp_path) == [path.name]


def test_a_path_that_is_allowed_is_left_as_it_was(tmp_path):
    (tmp_path / "there.json").write_text("old")
    check_writable(tmp_path / "there.json")
    check_writable(tmp_path / "new.json")
    assert names(tmp_path) == ["there.json"] and (tmp_path / "there.json").read_text() == "old"


@LINUX
def test_files_that_cannot_be_read_are_refused_at_once(tmp_path, monkeypatch):
    for name in ("folder", "long", "loop", "pipe", "nul"):
        path, _, _ = refused_paths(tmp_path)[name]
        with pytest.raises(ValueError, match="path="):
            existing_file(path, "pose")
        for p in tmp_path.iterdir():
            p.rmdir() if p.is_dir() else p.unlink()
    with pytest.raises(FileNotFoundError, match="there is no such pose"):
        existing_file(tmp_path / "absent" / "a", "pose")
    (tmp_path / "a").write_text("x")
    monkeypatch.setattr(storage.os, "access", lambda p, how: False)
    with pytest.raises(PermissionError, match="may not be read; allow reading this pose"):
        existing_file(tmp_path / "a", "pose")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0", "no mesh, but a pointer of"),
        (b"\xef\xbb\xbf\n<!DOCTYPE HTML><title>404", "no mesh, but a page of the web"),
        (b"Kaydara FBX Binary  \0", "no mesh, but an FBX file; open it in Blender"),
        (b"\x1f\x8b\x08\0", "no mesh, but packed with gzip; unpack"),
    ],
    ids=["lfs", "page", "fbx", "gzip"],
)
def test_a_file_that_is_plainly_something_else_is_refused_as_that(tmp_path, data, words):
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(ValueError, match=words):
        existing_file(tmp_path / "a", "mesh")


def test_a_file_that_is_open_elsewhere_is_replaced_once_it_is_closed(tmp_path, monkeypatch):
    path, replace, tries = tmp_path / "a.txt", os.replace, []
    path.write_text("old")

    def held(part, target):  # as Windows has it
        tries.append(part)
        if len(tries) < 3:
            raise PermissionError(13, "in use")
        replace(part, target)

    monkeypatch.setattr(os, "replace", held)
    monkeypatch.setattr(storage, "WAITS", (0, 0))
    with atomic_path(path) as part:
        part.write_text("new")
    assert path.read_text() == "new" and len(tries) == 3
    tries.clear()
    monkeypatch.setattr(storage, "WAITS", (0,))
    with pytest.raises(PermissionError, match=r"a.txt.*close it where it is open"):
        with atomic_path(path) as part:
            part.write_text("newer")
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"] and path.read_text() == "new"


# --- a full disk ----------------------------------------------------------------------------------

FULL = """
import resource, signal, sys
import numpy as np
from facelab.storage import save_npz
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    save_npz(sys.argv[1], "pose", 1, x=np.random.default_rng(0).normal(size=10_000))
except OSError as error:
    print(error)
"""


@POSIX
def test_a_full_disk_leaves_the_good_file_and_says_so(tmp_path):
    path = tmp_path / "pose.npz"
    save_npz(path, "pose", 1, x=[1.0])
    said = subprocess.run(
        [sys.executable, "-c", FULL, str(path)], capture_output=True, text=True, check=True
    ).stdout
    assert "pose.npz': the disk is full" in said and "stands unchanged" in said
    assert load_npz(path, "pose", 1)["x"].tolist() == [1.0]
    assert names(tmp_path) == ["pose.npz"]


# --- killed while writing -------------------------------------------------------------------------


def keep_writing(path, seed):
    rng = np.random.default_rng(seed)
    while True:
        n = int(rng.integers(1, 3000))
        save_npz(path, "pose", 1, n=n, x=np.full(n, float(n)))


@POSIX
def test_a_writer_killed_at_any_moment_leaves_a_whole_file(tmp_path):
    path, rng = tmp_path / "pose.npz", random.Random(0)
    save_npz(path, "pose", 1, n=0, x=[])
    start = multiprocessing.get_context("fork")
    for trial in range(30):
        writer = start.Process(target=keep_writing, args=(path, trial))
        writer.start()
        time.sleep(rng.uniform(0.005, 0.04))
        writer.kill()
        writer.join()
        stored = load_npz(path, "pose", 1)
        assert stored["x"].shape == (int(stored["n"]),) and (stored["x"] == stored["n"]).all()
    left = [p for p in tmp_path.iterdir() if p != path]
    assert all(p.name.startswith(".") for p in left)
    for p in left:
        os.utime(p, (time.time() - 7200,) * 2)
    save_npz(path, "pose", 1, n=0, x=[])
    assert names(tmp_path) == ["pose.npz"]


# --- hostile npz ----------------------------------------------------------------------------------


def header(shape, dtype="<f8"):
    """An npy header alone."""
    out = io.BytesIO()
    described = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(out, described)
    return out.getvalue()


def npy(array):
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asanyarray(array))
    return out.getvalue()


def hostile(path, *members, pack=zipfile.ZIP_DEFLATED):
    """An npz file of any bytes; those that say what it is are right."""
    about = [("facelab_kind.npy", npy("pose")), ("facelab_version.npy", npy(1))]
    with zipfile.ZipFile(path, "w", pack) as archive:
        for name, data in [*about, *members]:
            if isinstance(data, bytes):
                archive.writestr(name, data)
            else:
                with archive.open(name, "w", force_zip64=True) as out:
                    for piece in data:
                        out.write(piece)
    return path


def zeros(n_bytes):
    """A bomb: an array of zeros, packed to a thousandth."""
    yield header((n_bytes // 8,))
    for _ in range(n_bytes // 2**20):
        yield bytes(2**20)


HOSTILE = {
    "9 GB in a header": ([("x.npy", header((1_200_000_000,)))], "not as large as its header"),
    "beyond all numbers": ([("x.npy", header((2**62, 2**62)))], "not as large as its header"),
    "negative": ([("x.npy", header((-1,)) + bytes(8))], "header of x.npy|not as large"),
    "too little": ([("x.npy", npy(np.zeros(9))[:-8])], "not as large as its header"),
    "too much": ([("x.npy", npy(np.zeros(9)) + b"more")], "not as large as its header"),
    "a pickle": ([("x.npy", header((1,), "|O") + b"cos\nsystem\n")], "no plain array"),
    "records": ([("x.npy", npy(np.zeros(2, "i4,f8")))], "no plain array|header of x"),
    "bytes": ([("x.npy", npy(np.array([b"ab"])))], "no plain array"),
    "dates": ([("x.npy", npy(np.array(["2026-01-01"], "M8[D]")))], "no plain array"),
    "complex": ([("x.npy", npy(np.zeros(2, complex)))], "no plain array"),
    "code in a header": (
        [("x.npy", b"\x93NUMPY\x01\x00\x20\x00" + b"__import__('os').abort()".ljust(32))],
        "header of x.npy is damaged",
    ),
    "no header": ([("x.npy", b"hello")], "header of x.npy is damaged"),
    "a later format": ([("x.npy", b"\x93NUMPY\x09\x00" + bytes(64))], "header of x.npy is damaged"),
    "no array": ([("notes.txt", b"hello")], "'notes.txt' in it is no array"),
    "twice": ([("x.npy", npy([1.0])), ("x.npy", npy([2.0]))], "it holds 'x' twice"),
    "a bomb": ([("x.npy", zeros(2**29))], r"would take 0\.5 GB of memory, \d+ times its size"),
}


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_before_they_take_memory(tmp_path, name):
    members, message = HOSTILE[name]
    path = hostile(tmp_path / "a.npz", *members)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match=rf"a\.npz: not a readable facelab npz.*({message})"):
        load_npz(path, "pose", 1)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 100 * 1024  # kB


@pytest.mark.parametrize("pack", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_ways_of_packing_are_refused(tmp_path, pack):
    path = hostile(tmp_path / "a.npz", ("x.npy", npy(np.zeros(1000))), pack=pack)
    with pytest.raises(ValueError, match="packed in a way that is not used here"):
        load_npz(path, "pose", 1)


def test_a_header_that_promises_more_than_packing_can_hold_is_refused(tmp_path):
    path = hostile(tmp_path / "a.npz", ("x.npy", npy(np.zeros(10))))
    data = bytearray(path.read_bytes())
    entry = data.rfind(b"PK\x01\x02")  # of x, in the directory at the end
    data[entry + 24 : entry + 28] = (2**31).to_bytes(4, "little")  # its size when unpacked
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"a\.npz: not a readable"):
        load_npz(path, "pose", 1)


def test_arrays_that_compress_well_are_read(tmp_path):
    x = np.zeros(2_000_000)
    save_npz(tmp_path / "a.npz", "pose", 1, x=x)
    assert (tmp_path / "a.npz").stat().st_size < 30_000
    np.testing.assert_array_equal(load_npz(tmp_path / "a.npz", "pose", 1)["x"], x)


def test_a_file_tells_if_one_of_its_arrays_was_taken_out_or_put_in(tmp_path):
    save_npz(tmp_path / "a.npz", "pose", 1, x=[1.0], y=[2.0])
    whole = {}
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        whole = {name: archive.read(name) for name in archive.namelist()}
    for change, message in (
        (lambda m: m.pop("y.npy"), "y should be there"),
        (lambda m: m.update({"z.npy": m["y.npy"]}), "z should not be there"),
    ):
        members = dict(whole)
        change(members)
        with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
            for name, data in members.items():
                archive.writestr(name, data)
        with pytest.raises(ValueError, match=rf"b\.npz.*\({message}\)"):
            load_npz(tmp_path / "b.npz", "pose", 1)


def test_an_array_is_read_when_asked_for_and_as_wanted(tmp_path, rng):
    x = rng.normal(size=(4, 3))
    save_npz(tmp_path / "a.npz", "pose", 1, x=x, names=["a", "b"])
    with open_npz(tmp_path / "a.npz", "pose", 1) as stored:
        assert stored.names == ["x", "names"] and "x" in stored and "y" not in stored
        assert stored.shape("x") == (4, 3)
        np.testing.assert_array_equal(stored.read("x", ("n", 3), "f"), x)
        for wanted, message in (
            (("x", (5, 3), "f"), r"x has shape \(4, 3\), but shape \(5, 3\) is wanted"),
            (("x", (12,), "f"), r"but shape \(12\) is wanted"),
            (("x", None, "iu"), "x is of type float64, but integers are wanted"),
            (("names", None, "bf"), "but booleans or numbers are wanted"),
            (("y",), "it has no y"),
        ):
            with pytest.raises(ValueError, match=rf"a\.npz: .*do not fit together.*{message}"):
                stored.read(*wanted)


def test_what_is_wrong_with_the_content_names_the_file(tmp_path):
    save_npz(tmp_path / "a.npz", "pose", 1, x=[1.0])
    with pytest.raises(ValueError, match=r"a\.npz: .*\(x=3, but it must be 2 or less\); save it"):
        with open_npz(tmp_path / "a.npz", "pose", 1):
            raise TypeError("x=3, but it must be 2 or less.")
