"""A real Jupyter in a real Chromium, with a way to ask the kernel what the mouse did."""

import ast
import atexit
import json
import os
import secrets
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from functools import cache
from pathlib import Path

import nbformat
import pytest
from get_browser import find
from jupyter_client import BlockingKernelClient
from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parents[2]
VOILA = "--ServerApp.jpserver_extensions={'voila.server_extension': True}"
FLAGS = [  # software rendering, and nothing that calls home
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--disable-background-networking", "--no-first-run"),
    *("--disable-component-update", "--disable-sync", "--disable-quic"),
]


@cache
def _playwright():
    """One for all labs of a run: there cannot be two."""
    started = sync_playwright().start()
    atexit.register(started.stop)
    return started


class Lab:
    """A server started as `make lab` starts it, one notebook open in one page.

    Parameters
    ----------
    folder : Path
        Where the server runs; notebooks are copied there.
    no_delay : bool
        Whether to use the lab's own server configuration.
    app : {"jupyterlab", "notebook", "voila"}
        What shows the notebook; Voila as `make app` starts it.
    """

    def __init__(self, folder, no_delay=True, app="jupyterlab"):
        self.app = app
        self.folder = Path(folder)
        self.token = secrets.token_hex(16)
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            self.base = f"http://127.0.0.1:{s.getsockname()[1]}"
        self.env = {**os.environ, "JUPYTER_RUNTIME_DIR": str(self.folder / "runtime")}
        root = [] if no_delay else ["--allow-root"]  # the lab's own configuration sees to it
        config = [f"--config={ROOT / 'jupyter_server_config.py'}"] if no_delay else []
        self.log = open(self.folder / "server.log", "w")
        program = ["jupyter", "server", VOILA] if app == "voila" else [app]
        self.server = subprocess.Popen(
            [
                *(sys.executable, "-m", *program, *config, "--no-browser", *root),
                *(f"--port={self.base.rsplit(':', 1)[1]}", "--ServerApp.port_retries=0"),
                *(f"--IdentityProvider.token={self.token}", f"--ServerApp.root_dir={self.folder}"),
            ],
            stdout=self.log,
            stderr=self.log,
            env=self.env,
        )
        self._wait(lambda: self._get("/api") is not None, 90, f"{app} did not start")
        self.browser = _playwright().chromium.launch(executable_path=find(), args=FLAGS)
        self.page = self.browser.new_page(viewport={"width": 1400, "height": 1000})
        self.client = None

    def _get(self, path):
        try:
            with urllib.request.urlopen(
                f"{self.base}{path}?token={self.token}", timeout=5
            ) as reply:
                return json.load(reply)
        except OSError:
            return None

    def _wait(self, done, seconds, complaint):
        end = time.time() + seconds
        while not done():
            if time.time() > end or self.server.poll() is not None:
                raise TimeoutError(f"{complaint}; server log: {self.folder / 'server.log'}")
            time.sleep(0.3)

    def open(self, notebook, seconds=300):
        """Open a notebook, run all of it, wait until the kernel is quiet."""
        shutil.copy(notebook, self.folder)
        page, name = self.page, Path(notebook).name
        path = {"jupyterlab": "/lab/tree/", "notebook": "/notebooks/", "voila": "/voila/render/"}
        address = f"{self.base}{path[self.app]}{name}"
        page.goto(f"{address}?reset&token={self.token}", timeout=1000 * seconds)
        if self.app != "voila":
            page.wait_for_selector(".jp-Notebook .jp-Cell", timeout=90_000)
        self._wait(lambda: self._get("/api/kernels"), 60, "no kernel started")
        page.wait_for_timeout(1500)
        kernel = self._get("/api/kernels")[0]["id"]
        self.client = BlockingKernelClient()
        self.client.load_connection_file(str(self.folder / "runtime" / f"kernel-{kernel}.json"))
        self.client.start_channels()
        if self.app != "voila":
            self.run_cells(seconds)
        return self

    def run_cells(self, seconds=300):
        """Run the whole notebook by the menu, wait until the kernel is quiet."""
        self.page.get_by_role("menuitem", name="Run", exact=True).click()
        self.page.get_by_role("menuitem", name="Run All Cells", exact=True).click()
        self.page.wait_for_timeout(1500)
        self.run("pass", timeout=seconds)  # queued behind the cells

    def restart(self):
        """A new kernel in the same page: all that it knew is gone."""
        kernel = self._get("/api/kernels")[0]["id"]
        address = f"{self.base}/api/kernels/{kernel}/restart?token={self.token}"
        urllib.request.urlopen(urllib.request.Request(address, method="POST"), timeout=60).read()
        self.client.wait_for_ready(timeout=60)
        self.page.wait_for_timeout(1500)

    def bring_into_view(self):
        """Scroll to the first canvas and wait until nothing moves it any more."""
        canvas = self.page.locator("canvas").first
        canvas.wait_for(timeout=120_000)
        boxes = [None, "none yet"]
        while boxes[-4:] != [boxes[-1]] * 4:  # pictures that come late move the page
            canvas.scroll_into_view_if_needed()
            self.page.wait_for_timeout(400)
            boxes.append(canvas.bounding_box())
            assert len(boxes) < 80, "the page does not come to rest"

    def run(self, source, timeout=60, **expressions):
        """Run source in the notebook's kernel; values of expressions come back through JSON."""
        asked = {k: f"__import__('json').dumps({v})" for k, v in expressions.items()}
        ident = self.client.execute(source, silent=False, user_expressions=asked)
        while True:
            reply = self.client.get_shell_msg(timeout=timeout)
            if reply["parent_header"].get("msg_id") == ident:
                break
        content = reply["content"]
        assert content["status"] == "ok", content
        values = {}
        for name, value in content["user_expressions"].items():
            assert value["status"] == "ok", value
            values[name] = json.loads(ast.literal_eval(value["data"]["text/plain"]))
        return values

    def settle(self):
        """Wait until the page and the kernel have heard each other out."""
        self.page.wait_for_timeout(400)
        self.run("pass")
        self.page.wait_for_timeout(400)

    def close(self):
        """End browser, kernel and server."""
        if self.client:
            self.client.stop_channels()
        self.browser.close()
        self.server.terminate()
        self.server.wait(timeout=30)
        self.log.close()


CELLS = (
    "from facelab.widgets import PosingLab",
    "lab = PosingLab.example()\nlab",
    "twin = PosingLab(lab.session, lab.models, lab.props, width=240, height=276)\ntwin",
)


def write_notebook(path, cells):
    """A notebook of these code cells; its folder is made."""
    path.parent.mkdir(exist_ok=True)
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
    code = [nbformat.v4.new_code_cell(cell) for cell in cells]
    nbformat.write(nbformat.v4.new_notebook(cells=code, metadata=kernel), path)
    return path


@pytest.fixture(scope="module")
def posing_lab(tmp_path_factory):
    """A lab of the example face in JupyterLab, with a second view of its session below."""
    lab = Lab(tmp_path_factory.mktemp("lab"))
    try:
        lab.open(write_notebook(lab.folder / "source" / "posing.ipynb", CELLS))
        lab.bring_into_view()
        yield lab
    finally:
        lab.close()
