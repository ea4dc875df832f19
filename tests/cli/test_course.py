"""The notebooks and the page without make: copied over nothing, started with the right words."""

import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
from environment import ROOT

from facelab.cli import course, main

NOTEBOOKS = sorted(p.name for p in (ROOT / "notebooks").glob("*.ipynb"))
FILES = [*NOTEBOOKS, "lecturers.md"]


@pytest.fixture
def started(monkeypatch):
    """Commands that would have been started; nothing is."""
    commands = []

    monkeypatch.setattr(subprocess, "run", lambda command, check: commands.append(command))
    monkeypatch.setattr(subprocess, "Popen", lambda command: commands.append(command) or Server(0))
    return commands


class Server:
    """A process that ends as it is told: with a code, or after Ctrl+C when it is asked to end."""

    def __init__(self, *waits):
        self.waits, self.asked = list(waits), 0

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def wait(self, timeout=None):
        code = self.waits.pop(0)
        if isinstance(code, BaseException):
            raise code
        return code

    def terminate(self):
        self.asked += 1


def test_the_notebooks_are_copied_and_the_first_is_opened(started, tmp_path):
    folder = tmp_path / "my" / "course"
    assert main(["lab", str(folder), "--no-browser", "--port", "9123"]) == 0
    assert sorted(p.name for p in folder.iterdir()) == FILES
    data, lab = started
    assert data == [sys.executable, "-m", "facelab.data"]
    assert lab[:4] == [sys.executable, "-m", "jupyterlab", str(folder / "00_start.ipynb")]
    assert {"--no-browser", "--ServerApp.port=9123"} < set(lab)


def test_no_link_of_a_copy_leads_nowhere(tmp_path):
    main(["lab", str(tmp_path), "--only-copy"])
    for path in tmp_path.iterdir():
        for target in re.findall(r"\]\(([\w./-]+\.(?:ipynb|md))", path.read_text(encoding="utf-8")):
            assert (tmp_path / target).is_file(), f"{path.name}: {target}"


def test_a_notebook_that_was_changed_is_never_written_over(started, tmp_path, capsys):
    main(["lab", str(tmp_path), "--only-copy"])
    mine = tmp_path / NOTEBOOKS[2]
    mine.write_text("my own")
    (tmp_path / NOTEBOOKS[3]).unlink()
    capsys.readouterr()
    assert main(["lab", str(tmp_path), "--only-copy"]) == 0
    assert mine.read_text() == "my own" and (tmp_path / NOTEBOOKS[3]).is_file()
    said = capsys.readouterr().out
    assert "1 copied" in said and NOTEBOOKS[2] in said and NOTEBOOKS[1] not in said
    assert not started


def test_the_page_is_served_from_a_folder_of_ones_own(started, tmp_path):
    assert main(["app", str(tmp_path / "poses")]) == 0
    assert [p.name for p in (tmp_path / "poses").iterdir()] == ["posing.ipynb"]
    _, page = started
    assert page[1:3] == ["-m", "jupyter_server"] and "--no-browser" not in page
    assert f"--ServerApp.root_dir={(tmp_path / 'poses').resolve()}" in page
    assert "--ServerApp.default_url=/voila/render/posing.ipynb" in page


def test_a_machine_without_user_numbers_starts_too(started, tmp_path, monkeypatch):
    """As Windows is: it has no geteuid."""
    monkeypatch.delattr("os.geteuid", raising=False)
    assert main(["lab", str(tmp_path)]) == 0
    assert "--allow-root" not in started[1]


@pytest.mark.parametrize("hears", [True, False])
def test_ctrl_c_waits_for_the_server_to_end_and_ends_with_130(
    hears, started, tmp_path, monkeypatch
):
    late = subprocess.TimeoutExpired("server", 10)
    server = Server(KeyboardInterrupt(), *([] if hears else [late]), 0, 0)
    monkeypatch.setattr(subprocess, "Popen", lambda command: server)
    assert main(["app", str(tmp_path)]) == 130
    assert server.asked == (not hears)


def test_a_server_that_fails_ends_with_1(started, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(subprocess, "Popen", lambda command: Server(3))
    assert main(["lab", str(tmp_path)]) == 1
    assert "code 3" in capsys.readouterr().err


def test_an_installation_without_notebooks_says_so(tmp_path, monkeypatch, capsys):
    (tmp_path / "facelab").mkdir()
    away = SimpleNamespace(__file__=str(tmp_path / "facelab" / "__init__.py"))
    monkeypatch.setattr(course, "facelab", away)
    monkeypatch.setattr(course, "files", lambda name: [])
    assert main(["lab", str(tmp_path / "lab"), "--only-copy"]) == 1
    assert "lacks its notebooks" in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_and_a_port_that_is_none_are_wrong_usage(tmp_path, capsys):
    (tmp_path / "taken").write_text("a file")
    assert main(["lab", str(tmp_path / "taken"), "--only-copy"]) == 2
    assert "cannot be made" in capsys.readouterr().err
    assert main(["app", str(tmp_path / "new"), "--port", "99999"]) == 2
    assert "99999 is no port" in capsys.readouterr().err and not (tmp_path / "new").exists()


def test_a_folder_in_the_place_of_a_notebook_is_left_as_it_is(tmp_path, capsys):
    (tmp_path / course.FIRST).mkdir()
    assert main(["lab", str(tmp_path), "--only-copy"]) == 0
    assert f"left as they are, for they are yours by now: {course.FIRST}" in capsys.readouterr().out
