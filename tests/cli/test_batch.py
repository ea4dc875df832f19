"""One file or many: what is done, skipped, failed, stopped; what is said, and to whom."""

import json
import os
import subprocess
import sys

import pytest
from environment import ROOT
from shapes import grid_mesh

import facelab
from facelab import files
from facelab.cli import convert, main
from facelab.cli.batch import Job
from facelab.cli.terminal import plain

COMMANDS = (
    *("register", "train", "segment", "read-units", "translate", "pose", "convert"),
    *("lab", "app"),
)


@pytest.fixture
def folder(tmp_path):
    """A folder with two good meshes, one that breaks off, and a note."""
    folder = tmp_path / "in"
    folder.mkdir()
    for name, columns in (("a", 12), ("c", 14)):
        files.write_obj(folder / f"{name}.obj", grid_mesh(columns, 10, 15.0))
    (folder / "b.obj").write_text("v 0 0 0\nv 1 0\n")
    (folder / "note.txt").write_text("take two was better")
    return folder


def convert_all(folder, *more):
    out = folder.parent / "out"
    report = folder.parent / "report.json"
    code = main(
        ["convert", str(folder), "-o", str(out), "--to", "ply", "--report", str(report), *more]
    )
    return code, json.loads(report.read_text()), out


def test_a_folder_goes_on_past_a_bad_file_and_says_all(folder, capsys):
    code, report, out = convert_all(folder)
    assert code == 1
    assert sorted(p.name for p in out.iterdir()) == ["a.ply", "c.ply"]
    assert [facelab.read_mesh(out / f"{n}.ply").n_vertices for n in "ac"] == [120, 140]
    assert [d["vertices"] for d in report["done"]] == [120, 140]
    (failed,) = report["failed"]
    assert failed["input"] == str(folder / "b.obj") and "line 2" in failed["reason"]
    assert report["passed_over"] == [str(folder / "note.txt")]
    shown = capsys.readouterr()
    assert "2 done, 1 failed, 1 passed over" in shown.out
    (line,) = shown.err.splitlines()
    assert line.startswith("failed: ") and "b.obj" in line


def test_what_is_done_is_skipped_unless_asked_again(folder):
    (folder / "b.obj").unlink()
    code, report, out = convert_all(folder)
    made = {p.name: p.stat().st_mtime_ns for p in out.iterdir()}
    assert (code, len(report["done"]), len(report["skipped"])) == (0, 2, 0)
    code, report, _ = convert_all(folder)
    assert (code, len(report["done"]), len(report["skipped"])) == (0, 0, 2)
    assert {p.name: p.stat().st_mtime_ns for p in out.iterdir()} == made
    code, report, _ = convert_all(folder, "--again")
    assert (code, len(report["done"]), len(report["skipped"])) == (0, 2, 0)


def test_a_source_that_is_newer_than_its_result_is_done_again(folder):
    (folder / "b.obj").unlink()
    _, _, out = convert_all(folder)
    later = (out / "a.ply").stat().st_mtime + 10
    os.utime(folder / "a.obj", (later, later))
    _, report, _ = convert_all(folder)
    assert [d["output"] for d in report["done"]] == [str(out / "a.ply")]


def test_ctrl_c_ends_with_130_says_what_was_done_and_leaves_no_half_file(
    folder, monkeypatch, capsys
):
    (folder / "b.obj").unlink()
    write = convert.WRITERS[".ply"]

    def interrupted(path, mesh):
        if mesh.n_vertices == 140:
            raise KeyboardInterrupt
        write(path, mesh)

    monkeypatch.setitem(convert.WRITERS, ".ply", interrupted)
    code, report, out = convert_all(folder)
    assert code == 130 and report["stopped"]
    assert [p.name for p in out.iterdir()] == ["a.ply"]
    assert report["not_reached"] == [str(folder / "c.obj")]
    assert "stopped: 1 done, 1 not reached" in capsys.readouterr().out


def test_a_fault_of_our_own_does_not_stop_the_rest_and_shows_where_it_was(
    folder, monkeypatch, capsys
):
    (folder / "b.obj").unlink()
    write = convert.WRITERS[".ply"]

    def faulty(path, mesh):
        if mesh.n_vertices == 120:
            raise KeyError("no such thing")
        write(path, mesh)

    monkeypatch.setitem(convert.WRITERS, ".ply", faulty)
    code, report, out = convert_all(folder)
    assert code == 1 and [p.name for p in out.iterdir()] == ["c.ply"]
    assert "KeyError" in report["failed"][0]["reason"]
    assert "Traceback" in capsys.readouterr().err


def test_one_file_that_fails_is_one_line_without_a_traceback(folder, capsys):
    code = main(["convert", str(folder / "b.obj"), "-o", str(folder / "b.ply")])
    said = capsys.readouterr()
    assert code == 1 and "Traceback" not in said.err and len(said.err.splitlines()) == 1
    assert not (folder / "b.ply").exists()


@pytest.mark.parametrize(
    ("more", "what"),
    [
        (["{in}/a.obj", "{in}/c.obj", "-o", "{in}/one.ply"], "name a folder"),
        (["{in}/nowhere.obj", "-o", "{in}/x.ply"], "is not there"),
        (["{in}/a.obj", "-o", "{in}/a.obj"], "would overwrite"),
        (["{in}/a.obj", "-o", "{in}/a.stl"], "a result ends in"),
        (["{in}/a.obj", "-o", "{in}/x.ply", "--report", "{in}/a.obj"], "would overwrite"),
        (["{in}", "-o", "{in}/../out", "--report", "{in}/c.obj"], "would overwrite"),
        (["{in}/a.obj", "-o", "{in}/x.ply", "--report", "{in}/X.ply"], "or a result"),
        (["{in}/a.obj", "-o", "{in}/a.ply", "--to", "glb"], "leave one of them out"),
        (["{in}/empty", "-o", "{in}/x"], "holds no file"),
        (["{in}/a.obj", "-o", "{in}/note.txt/x.ply"], "cannot be made"),
        (["{in}/a.obj", "-o", "{in}/x.ply", "--report", "{in}/no/r.json"], "--report"),
        (["{in}/a.obj"], "required"),
        (["", "-o", "{in}/x.ply"], "the name is empty"),
        (["{in}/a.obj", "-o", ""], "the name is empty"),
        (["{in}/a.obj", "-o", "{in}/x.ply", "--frob"], "unrecognized"),
    ],
)
def test_wrong_usage_ends_with_2_before_anything_is_written(folder, more, what, capsys):
    (folder / "empty").mkdir()
    before = sorted(folder.rglob("*"))
    assert main(["convert", *(m.replace("{in}", str(folder)) for m in more)]) == 2
    assert what in capsys.readouterr().err
    assert sorted(folder.rglob("*")) == before


def test_a_link_that_leads_nowhere_and_a_pipe_are_failed_files(folder):
    (folder / "lost.obj").symlink_to(folder / "nowhere.obj")
    os.mkfifo(folder / "pipe.obj")
    (folder / "sub.obj").mkdir()
    code, report, _ = convert_all(folder)
    assert code == 1 and len(report["done"]) == 2
    failed = [entry["input"] for entry in report["failed"]]
    assert failed == [str(folder / name) for name in ("b.obj", "lost.obj", "pipe.obj")]


def test_two_files_that_would_become_one_are_refused_by_name(folder, capsys):
    (folder / "b.obj").unlink()
    files.write_ply(folder / "A.ply", grid_mesh(9, 9, 15.0))
    code = main(["convert", str(folder), "-o", str(folder.parent / "out"), "--to", "glb"])
    said = capsys.readouterr()
    assert code == 1 and "makes" in said.err and "another name" in said.err
    assert len(list((folder.parent / "out").iterdir())) == 2


def test_a_target_that_is_a_folder_fails_and_the_rest_goes_on(folder):
    (folder.parent / "out" / "a.ply").mkdir(parents=True)
    code, report, out = convert_all(folder)
    assert code == 1 and (out / "c.ply").is_file()
    assert {f["input"] for f in report["failed"]} == {str(folder / n) for n in ("a.obj", "b.obj")}


def test_names_and_texts_of_files_cannot_command_the_terminal(folder, capsys):
    evil = folder / "a\x1b[2J\u202eb.obj"
    evil.write_text("v 0 0 \x1b]0;owned\x07\n")
    convert_all(folder)
    said = capsys.readouterr()
    assert "\\x1b[2J\\u202eb.obj" in said.err
    assert not {*(said.out + said.err)} & {*"\x1b\x07\u202e"}


def test_plain_text_is_left_as_it_is_line_ends_become_blanks():
    assert plain("λ = 0.5,  größer\n than\tthat") == "λ = 0.5,  größer than that"
    assert plain("bytes \udcff") == "bytes \\udcff"


def test_warnings_are_lines_on_stderr_and_stand_in_the_report(folder, capsys):
    (folder / "b.obj").unlink()
    files.write_obj(folder / "c.obj", grid_mesh(14, 10, 1500.0))  # metres wide: no face
    _, report, _ = convert_all(folder)
    said = [len(d["warnings"]) for d in report["done"]]
    assert said[0] == 0 and said[1] >= 1
    assert "warning: " in capsys.readouterr().err


def test_a_folder_of_sources_is_done_only_as_long_as_nothing_in_it_is_newer(tmp_path):
    shapes, target = tmp_path / "shapes", tmp_path / "rig.npz"
    shapes.mkdir()
    (shapes / "smile.obj").write_text("v")
    target.write_text("made")
    assert Job((shapes,), target).done
    later = target.stat().st_mtime + 10
    os.utime(shapes / "smile.obj", (later, later))
    assert not Job((shapes,), target).done


def test_a_result_is_made_anew_when_a_file_that_an_option_names_is_newer(tmp_path):
    take, rig, target = (tmp_path / name for name in ("take.csv", "rig.npz", "made.csv"))
    for path in (take, rig, target):
        path.write_text("there")
    assert Job((take,), target, (rig,)).done
    later = target.stat().st_mtime + 10
    os.utime(rig, (later, later))
    assert not Job((take,), target, (rig,)).done


# --- as a process ---------------------------------------------------------------------------------


def facelab_process(*arguments, **options):
    here = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "facelab", *map(str, arguments)]
    return subprocess.Popen(command, env=here, text=True, **options)


def test_python_m_facelab_shows_every_command():
    pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = facelab_process("--help", **pipe)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0 and not err
    for name in COMMANDS:
        assert name in out


def test_help_needs_nothing_that_takes_long_to_import():
    heavy = "[m for m in ('scipy', 'sklearn', 'matplotlib', 'facelab.files') if m in sys.modules]"
    code = f"import sys, facelab.cli; facelab.cli.main(['--help']); sys.exit({heavy} or 0)"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(ROOT)},
        text=True, capture_output=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_letters_that_a_pipe_has_not_are_written_out(monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "cp1252")  # as a pipe on Windows
    pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = facelab_process("read-units", "--help", **pipe)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0 and not err
    assert "\\u03bb of Eq. 9" in out


def test_a_reader_that_leaves_does_not_stop_the_work(folder):
    (folder / "b.obj").unlink()
    read, write = os.pipe()
    os.close(read)  # nobody reads
    out = folder.parent / "out"
    process = facelab_process(
        "convert", folder, "-o", out, "--to", "ply", stdout=write, stderr=subprocess.PIPE
    )
    os.close(write)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0 and "Traceback" not in err and "Broken" not in err
    assert sorted(p.name for p in out.iterdir()) == ["a.ply", "c.ply"]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_every_command_has_an_example_of_its_own(name, capsys):
    assert main([name, "--help"]) == 0
    assert f"facelab {name} " in capsys.readouterr().out.split("examples:")[1]
