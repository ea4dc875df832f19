import json
import shutil

import numpy as np
import pytest

import data_synth.__main__ as command
from data_synth.capture import Capture, make_capture, open_capture, recording, store
from facelab.data.actors import load_capture
from facelab.keeping import fault


def test_equal_seeds_give_equal_bytes_and_others_do_not(tmp_path, tiny):
    about = []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        made = make_capture("M1", tmp_path / name, "tiny", seed, progress=False)
        about.append(json.loads((made.folder / "manifest.json").read_text())["files"])
    assert about[0] == about[1]
    assert all(about[0][f] != about[2][f] for f in ("pride_1.c3d", "rom.c3d", "truth.npz"))


def test_a_capture_is_made_once(tmp_path, tiny, monkeypatch):
    first = open_capture("M1", tmp_path, "tiny", progress=False)
    assert first.folder == tmp_path / "data_synth-tiny-0" / "M1"
    monkeypatch.setattr(store, "record", None)
    again = open_capture("M1", tmp_path, "tiny")
    assert again.texts == first.texts and again.seal == first.seal


def cut(folder):
    file = folder / "rom.c3d"
    file.write_bytes(file.read_bytes()[:-5000])


def flip(folder):
    data = bytearray((folder / "truth.npz").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "truth.npz").write_bytes(data)


def change(name, **entries):
    """Damage that leaves a JSON file readable."""

    def damage(folder):
        about = json.loads((folder / name).read_text())
        (folder / name).write_text(json.dumps({**about, **entries}))

    return damage


DAMAGE = {
    "rom.c3d is damaged": cut,
    "truth.npz is damaged": flip,
    "rage_5.c3d is missing": lambda folder: (folder / "rage_5.c3d").unlink(),
    "takes.json is damaged": change("takes.json", takes={"rom": {"fps": 60.0}}),
    "no manifest": lambda folder: (folder / "manifest.json").unlink(),
    "manifest is damaged": change("manifest.json", files={}),
    "manifest is damaged.": change("manifest.json", key={"actor": "F1", "code": "0"}),
}


@pytest.mark.parametrize("words, damage", DAMAGE.items(), ids=list(DAMAGE))
def test_a_damaged_capture_is_noticed_and_made_again(tmp_path, tiny, words, damage):
    made = open_capture("M1", tmp_path, "tiny", progress=False)
    damage(made.folder)
    with pytest.raises(ValueError, match=f"holds no whole capture: .*{words}"):
        Capture(made.folder)
    again = open_capture("M1", tmp_path, "tiny", progress=False)
    assert fault(again.folder) is None
    assert again.markers("rom").n_frames == 90 and again.fps == 30
    assert [f.name for f in made.folder.parent.iterdir()] == ["M1"]


def test_a_cache_made_by_other_code_is_made_again_and_its_skin_not_guessed(
    tmp_path, tiny, monkeypatch
):
    with monkeypatch.context() as before:
        before.setattr(store, "source_stamp", lambda *_: "0123")
        made = open_capture("M1", tmp_path, "tiny", progress=False)
    with pytest.raises(ValueError, match="made by another version of data_synth"):
        Capture(made.folder).surface("rom", [0])
    open_capture("M1", tmp_path, "tiny", progress=False).surface("rom", [0])


@pytest.mark.parametrize("accident", [KeyboardInterrupt, OSError, MemoryError])
def test_an_interrupted_run_leaves_nothing(tmp_path, tiny, monkeypatch, accident):
    write, written = recording.write_c3d, []

    def interrupted(path, markers):
        if len(written) == 2:
            raise accident("in the middle")
        written.append(path)
        write(path, markers)

    monkeypatch.setattr(recording, "write_c3d", interrupted)
    with pytest.raises(accident, match="in the middle"):
        open_capture("M1", tmp_path, "tiny", progress=False)
    assert len(written) == 2
    assert not list((tmp_path / "data_synth-tiny-0").iterdir())


def test_a_full_disk_is_noticed_before_anything_is_sealed(tmp_path, tiny):
    """A limit on the size of files stands for the disk."""
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, limits[1]))
    try:
        with pytest.raises(OSError, match="disk is full"):
            open_capture("M1", tmp_path, "tiny", progress=False)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list((tmp_path / "data_synth-tiny-0").iterdir())
    assert fault(open_capture("M1", tmp_path, "tiny", progress=False).folder) is None


def test_without_a_place_to_keep_them_captures_are_made_all_the_same(tmp_path, tiny, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.warns(UserWarning, match="cannot be written .*temporary folder.*FACELAB_CACHE"):
        capture = load_capture("M1", "tiny", random_state=5, progress=False)
    assert capture.markers("rom").n_frames == 90
    with pytest.raises(OSError):  # a folder that somebody named is no place to be replaced
        load_capture("M1", "tiny", root=tmp_path / "file" / "mine", progress=False)


def test_a_folder_with_something_in_it_is_not_written_over(tmp_path, tiny):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(FileExistsError, match="holds something already"):
        make_capture("M1", tmp_path, "tiny")
    assert [f.name for f in tmp_path.iterdir()] == ["thesis.tex"]


def test_the_facade_keeps_captures_in_the_cache(tmp_path, tiny, monkeypatch):
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))
    capture = load_capture("M1", "tiny", random_state=2, progress=False)
    assert capture.folder == tmp_path / "data_synth-tiny-2" / "M1"
    assert capture.random_state == 2


@pytest.mark.parametrize(
    "asked, error, words",
    [
        (
            {"actor": "M9"},
            ValueError,
            "actor='M9' is unknown; choose one of 'M1', 'F1', 'M2', 'F2'",
        ),
        ({"size": "huge"}, ValueError, "size='huge' is unknown; choose one of 'default', 'small'"),
        ({"random_state": -1}, ValueError, "random_state=-1, but it must be 0 or more"),
        ({"random_state": 1.5}, TypeError, "random_state=1.5 is not an integer"),
        ({"random_state": None}, TypeError, "random_state=None is not an integer"),
    ],
)
def test_what_cannot_be_made_is_refused_before_anything_is_written(tmp_path, asked, error, words):
    with pytest.raises(error, match=words):
        load_capture(**{"actor": "M1", "root": tmp_path, **asked})
    assert not list(tmp_path.iterdir())


def test_a_rig_with_other_units_is_refused(tmp_path, tiny, rig):
    other = rig.linear()
    object.__setattr__(other, "names", (*other.names[:-1], "AU99"))
    with pytest.raises(ValueError, match=r"rig.names is .*AU99, but must be the forty units"):
        make_capture("M1", tmp_path / "M1", "tiny", rig=other, progress=False)
    assert not list(tmp_path.iterdir())


# --- the command ----------------------------------------------------------------------------------


def test_the_command_makes_what_it_is_asked_for(tmp_path, tiny, capsys):
    assert command.main(["--out", str(tmp_path), "--actors", "M1", "--size", "tiny"]) == 0
    out, progress = capsys.readouterr()
    assert "Capture(M1" in out
    assert "M1: capture" in progress
    assert fault(tmp_path / "data_synth-tiny-0" / "M1") is None


def test_the_command_says_what_went_wrong(tmp_path, tiny, capsys, monkeypatch):
    (tmp_path / "file").touch()
    asked = ["--actors", "M1", "--size", "tiny", "--quiet", "--out"]
    assert command.main([*asked, str(tmp_path / "file")]) == 1
    assert "Could not write to" in capsys.readouterr().err

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "open_capture", interrupted)
    assert command.main([*asked, str(tmp_path)]) == 130
    assert "nothing half-made" in capsys.readouterr().err
    for wrong in (["--actors", "M7"], ["--size", "huge"], ["--random-state", "-1"]):
        with pytest.raises(SystemExit):
            command.main(wrong)


def test_no_other_mesh_is_needed_than_one_with_landmarks(rig, tmp_path, tiny):
    """Another rig that keeps to the protocol takes the same way: here the linear one."""

    class Linear:
        names, neutral, deltas = rig.names, rig.neutral, rig.deltas

        def animate(self, weights, vertices=None):
            pick = slice(None) if vertices is None else vertices
            moved = np.tensordot(weights, self.deltas[:, pick], axes=1)
            return self.neutral.vertices[pick] + moved

    made = make_capture("M1", tmp_path / "M1", "tiny", rig=Linear(), progress=False)
    assert made.surface("rom", [0]).shape == (1, rig.neutral.n_vertices, 3)
    shutil.rmtree(made.folder)
