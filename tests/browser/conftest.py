"""A real JupyterLab in a real Chromium, with a way to ask the kernel what the mouse did."""

import ast
import json
import os
import secrets
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest
from get_browser import find
from jupyter_client import BlockingKernelClient
from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parents[2]
FLAGS = [  # software rendering, and nothing that calls home
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--disable-background-networking", "--no-first-run"),
    *("--disable-component-update", "--disable-sync", "--disable-quic"),
]


class Lab:
    """JupyterLab started as `make lab` starts it, one notebook open in one page.

    Parameters
    ----------
    folder : Path
        Where the server runs; notebooks are copied there.
    no_delay : bool
        Whether to use the lab's own server configuration.
    """

    def __init__(self, folder, no_delay=True):
        self.folder = Path(folder)
        self.token = secrets.token_hex(16)
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            self.base = f"http://127.0.0.1:{s.getsockname()[1]}"
        self.env = {**os.environ, "JUPYTER_RUNTIME_DIR": str(self.folder / "runtime")}
        root = [] if no_delay else ["--allow-root"]  # the lab's own configuration sees to it
        config = [f"--config={ROOT / 'jupyter_server_config.py'}"] if no_delay else []
        self.log = open(self.folder / "server.log", "w")
        self.server = subprocess.Popen(
            [
                *(sys.executable, "-m", "jupyterlab", *config, "--no-browser", *root),
                *(f"--port={self.base.rsplit(':', 1)[1]}", "--ServerApp.port_retries=0"),
                *(f"--IdentityProvider.token={self.token}", f"--ServerApp.root_dir={self.folder}"),
            ],
            stdout=self.log,
            stderr=self.log,
            env=self.env,
        )
        self._wait(lambda: self._get("/api") is not None, 90, "JupyterLab did not start")
        self.playwright = sync_playwright().start()
        self.browser = self.playwright.chromium.launch(executable_path=find(), args=FLAGS)
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
        page = self.page
        page.goto(f"{self.base}/lab/tree/{Path(notebook).name}?reset&token={self.token}")
        page.wait_for_selector(".jp-Notebook .jp-Cell", timeout=90_000)
        self._wait(lambda: self._get("/api/kernels"), 60, "no kernel started")
        page.wait_for_timeout(1500)
        page.get_by_role("menuitem", name="Run", exact=True).click()
        page.get_by_role("menuitem", name="Run All Cells", exact=True).click()
        kernel = self._get("/api/kernels")[0]["id"]
        self.client = BlockingKernelClient()
        self.client.load_connection_file(str(self.folder / "runtime" / f"kernel-{kernel}.json"))
        self.client.start_channels()
        page.wait_for_timeout(1500)
        self.run("pass", timeout=seconds)  # queued behind the cells
        return self

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
        self.playwright.stop()
        self.server.terminate()
        self.server.wait(timeout=30)
        self.log.close()


@pytest.fixture(scope="module")
def posing_lab(tmp_path_factory):
    """Notebook 05, run from top to bottom, its lab in view."""
    lab = Lab(tmp_path_factory.mktemp("lab"))
    try:
        lab.open(ROOT / "notebooks" / "05_posing.ipynb")
        canvas = lab.page.locator(".jp-OutputArea canvas").first
        boxes = [None, "none yet"]
        while boxes[-4:] != [boxes[-1]] * 4:  # pictures that come late move the page
            canvas.scroll_into_view_if_needed()
            lab.page.wait_for_timeout(700)
            boxes.append(canvas.bounding_box())
            assert len(boxes) < 60, "the page does not come to rest"
        yield lab
    finally:
        lab.close()
