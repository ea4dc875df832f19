"""facelab lab, facelab app: the notebooks in a folder of one's own, and the posing lab as a page.

Both come with the package, as data of its installation; in a source tree they are at its root.
"""

import argparse
import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import facelab
from facelab.cli.batch import DONE, FAILED, STOPPED, make_folder
from facelab.cli.terminal import complain, say
from facelab.storage import atomic_path

FIRST = "00_start.ipynb"
PAGE = "posing.ipynb"
FOLDER = "facelab-lab"
KINDS = {".ipynb", ".md"}
"""What is copied: notebooks, and texts that they link to."""

_PATIENCE = 10.0  # seconds in which a server of Jupyter has ended its kernels
_NO_DELAY = "facelab.widgets.server.NoDelayConnection"


def add_commands(add):
    """Add both to the parser: `add(name, text, example)` makes one."""
    for name, text, example in (
        (
            "lab",
            "the notebooks copied into a folder of your own, and opened in JupyterLab",
            "A notebook that is there is never written over.\n\nexamples:\n  facelab lab\n"
            "  facelab lab my-course --no-browser\n  facelab lab my-course --only-copy\n",
        ),
        (
            "app",
            "the posing lab as a page of its own",
            "Poses are kept in the folder.\n\nexamples:\n  facelab app\n"
            "  facelab app poses --no-browser\n",
        ),
    ):
        parser = add(name, text, example)
        parser.add_argument("folder", nargs="?", type=Path, default=Path(FOLDER))
        parser.add_argument("--no-browser", action="store_true", help="only say the address")
        parser.add_argument("--port", type=_port, help="the next free one from 8888 if left out")
        parser.add_argument("--only-copy", action="store_true", help="and start nothing")


def _port(text):
    port = int(text)
    if not 1 <= port <= 65535:
        raise argparse.ArgumentTypeError(f"{port} is no port; give one from 1024 to 65535")
    return port


def lab(options):
    """Copy the notebooks and open the first in JupyterLab: the exit code."""
    copied(course_files("notebooks"), options.folder)
    if options.only_copy:
        return DONE
    return _started(["-m", "jupyterlab", str(options.folder / FIRST)], options)


def app(options):
    """Copy the page and open it in a browser: the exit code."""
    copied([f for f in course_files("app") if f.name == PAGE], options.folder)
    if options.only_copy:
        return DONE
    page = [
        f"--ServerApp.root_dir={options.folder.resolve()}",
        "--ServerApp.jpserver_extensions={'voila.server_extension': True}",
        f"--ServerApp.default_url=/voila/render/{PAGE}",
    ]
    return _started(["-m", "jupyter_server", *page], options)


COMMANDS = {"lab": lab, "app": app}


def course_files(part):
    """The notebooks of "notebooks" or "app", and texts beside them, wherever they were installed.

    Returns
    -------
    list of Path

    Raises
    ------
    FileNotFoundError
        If the installation lacks them.
    """
    tree = Path(facelab.__file__).resolve().parents[1] / part
    found = sorted(f for f in tree.glob("*") if f.suffix in KINDS)
    if not found:
        try:
            held = files("facelab") or []
        except PackageNotFoundError:
            held = []
        home = ("share", "facelab", part)
        found = [Path(f.locate()) for f in held if f.parts[-4:-1] == home and f.suffix in KINDS]
        found = sorted(f.resolve() for f in found if f.is_file())
    if not found:
        raise FileNotFoundError(
            f"this installation of facelab lacks its {part}; install it again, from the wheel."
        )
    return found


def copied(sources, folder):
    """Copy notebooks into a folder, over none that is there; say what was done.

    Returns
    -------
    new, kept : list of str
        Names of those that were copied, and of those that are there and differ from ours.
    """
    make_folder(folder)
    new, kept = [], []
    for source in sources:
        target, ours = folder / source.name, source.read_bytes()
        if not target.exists():
            with atomic_path(target) as part:
                part.write_bytes(ours)
            new.append(source.name)
        elif not target.is_file() or target.read_bytes() != ours:
            kept.append(source.name)
    if new:
        say(f"{folder}: {len(new)} copied")
    if kept:
        say(f"{folder}: left as they are, for they are yours by now: {', '.join(kept)}")
    return new, kept


def _started(arguments, options):
    """Fetch the data, then run a server of Jupyter until it ends: the exit code."""
    command = [sys.executable, *arguments]
    command.append("--ServerApp.answer_yes=True")  # Ctrl+C is enough
    command.append(f"--ServerApp.kernel_websocket_connection_class={_NO_DELAY}")
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        command.append("--allow-root")  # in a container one is root, and may be
    if options.port is not None:
        command.append(f"--ServerApp.port={options.port}")
    if options.no_browser:
        command.append("--no-browser")
    try:
        subprocess.run([sys.executable, "-m", "facelab.data"], check=False)
    except KeyboardInterrupt:
        return STOPPED
    code, stopped = _until_it_ends(command)
    if stopped:
        return STOPPED
    if code:
        complain(f"facelab {options.command}: the server of Jupyter ended with code {code}.")
    return FAILED if code else DONE


def _until_it_ends(command):
    """Run a server: its exit code, and whether Ctrl+C ended it. It ends its kernels by itself."""
    with subprocess.Popen(command) as server:
        try:
            return server.wait(), False
        except KeyboardInterrupt:  # from a terminal the server heard it too
            try:
                server.wait(timeout=_PATIENCE)
            except subprocess.TimeoutExpired:
                server.terminate()
            return server.wait(), True
