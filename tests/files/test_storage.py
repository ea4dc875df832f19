import struct
import zipfile

import numpy as np
import pytest
from shapes import sphere_mesh

from facelab import storage
from facelab.files.obj import write_obj
from facelab.files.ply import write_ply
from facelab.storage import atomic_path, load_npz, save_npz

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
SQUARE = TRIANGLE + "v 1 1 0\n"


@pytest.fixture
def write(tmp_path):
    """Write text or bytes to a file and give its path."""

    def write(content, name="face.obj"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


# --- whole files or none --------------------------------------------------------------------------


def test_a_failed_write_leaves_the_old_file_and_nothing_beside_it(write, tmp_path):
    path = write("old", "face.obj")
    with pytest.raises(KeyboardInterrupt), atomic_path(path) as part:
        part.write_text("half of the n")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["face.obj"]


def test_the_old_file_stands_until_the_new_one_is_whole(write, tmp_path):
    path = write("old", "face.obj")
    with atomic_path(path) as part:
        part.write_text("new")
        assert path.read_text() == "old"
        assert part.parent == path.parent  # another disk could not be swapped in at once
    assert path.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["face.obj"]


@pytest.mark.parametrize(
    "name, save",
    [
        ("a.obj", lambda path: write_obj(path, sphere_mesh(0))),
        ("a.ply", lambda path: write_ply(path, sphere_mesh(0))),
        ("a.npz", lambda path: save_npz(path, "pose", 1, x=[1.0])),
    ],
    ids=["obj", "ply", "npz"],
)
def test_every_writer_keeps_the_old_file_when_the_disk_fails(write, monkeypatch, name, save):
    path = write("old", name)

    def fail(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(storage.os, "replace", fail)
    with pytest.raises(OSError, match="no space left"):
        save(path)
    assert path.read_text() == "old"
    assert [p.name for p in path.parent.iterdir()] == [name]


def test_writing_into_a_missing_folder_is_refused_by_name(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"folder .*nowhere does not exist"):
        write_obj(tmp_path / "nowhere" / "a.obj", sphere_mesh(0))


def test_written_files_can_be_read_by_others_as_any_file(tmp_path, write):
    write_obj(tmp_path / "a.obj", sphere_mesh(0))
    assert (tmp_path / "a.obj").stat().st_mode == write("x", "b").stat().st_mode


# --- npz ------------------------------------------------------------------------------------------


def test_arrays_come_back_as_they_were_saved(tmp_path, rng):
    arrays = {
        "floats": rng.normal(size=(3, 4)).astype(np.float32),
        "numbers": np.arange(5),
        "names": np.array(["jawOpen", "Ärger"]),
        "mask": np.array([True, False]),
        "empty": np.zeros((0, 3)),
        "single": 2.5,
    }
    save_npz(tmp_path / "a.npz", "pose", 1, **arrays)
    again = load_npz(tmp_path / "a.npz", "pose", 1)
    assert set(again) == set(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(again[name], array)
        assert again[name].dtype == np.asarray(array).dtype


def test_python_objects_are_refused_when_saving_by_name(tmp_path):
    with pytest.raises(TypeError, match="bad, worse: Python objects cannot be stored"):
        save_npz(tmp_path / "a.npz", "pose", 1, ok=[1], bad=[{}], worse=np.array([None]))
    assert list(tmp_path.iterdir()) == []


class Bomb:
    """Leaves a mark when it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return (open, (str(self.mark), "w"))


def test_a_pickle_in_a_file_is_never_opened(tmp_path):
    mark = tmp_path / "boom"
    np.savez(
        tmp_path / "a.npz",
        facelab_kind="pose",
        facelab_version=1,
        x=np.array([Bomb(mark)], dtype=object),
    )
    with pytest.raises(ValueError, match=r"a.npz: not a readable facelab npz"):
        load_npz(tmp_path / "a.npz", "pose", 1)
    assert not mark.exists()


@pytest.mark.parametrize("kind, version", [("clip", 1), ("pose", 2), ("pose", 0)])
def test_a_file_of_another_kind_or_version_is_refused_with_both(tmp_path, kind, version):
    save_npz(tmp_path / "a.npz", "pose", 1, x=[1.0])
    words = f"a.npz holds 'pose' of version 1, but '{kind}' of version {version} is wanted"
    with pytest.raises(ValueError, match=words):
        load_npz(tmp_path / "a.npz", kind, version)


@pytest.mark.parametrize("part", [0.01, 0.3, 0.6, 0.9, 0.999])
def test_a_truncated_npz_is_refused_by_name(tmp_path, rng, part):
    path = tmp_path / "a.npz"
    save_npz(path, "pose", 1, x=rng.normal(size=(50, 3)))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(ValueError, match=r"a.npz: not a readable facelab npz"):
        load_npz(path, "pose", 1)


def test_a_flipped_byte_within_an_npz_is_noticed(tmp_path, rng):
    path = tmp_path / "a.npz"
    save_npz(path, "pose", 1, x=rng.normal(size=(50, 3)))
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("x.npy").header_offset
    data = bytearray(path.read_bytes())
    name, extra = struct.unpack_from("<HH", data, start + 26)  # lengths, zip local file header
    data[start + 30 + name + extra + 300] ^= 1
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"a.npz: not a readable facelab npz"):
        load_npz(path, "pose", 1)


def test_files_that_are_not_ours_are_refused_by_name(tmp_path, write):
    np.savez(tmp_path / "other.npz", x=[1.0])
    np.save(tmp_path / "array.npy", [1.0])
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    write("hello", "text.npz")
    for name in ("other.npz", "array.npz", "text.npz"):
        with pytest.raises(ValueError, match=f"{name}: not a readable facelab npz"):
            load_npz(tmp_path / name, "pose", 1)


def test_npz_files_are_called_npz(tmp_path):
    with pytest.raises(ValueError, match=r"must end in .npz"):
        save_npz(tmp_path / "a.pose", "pose", 1, x=[1.0])
