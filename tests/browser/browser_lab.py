"""A real Jupyter in a real Chromium, with a way to ask the kernel what the mouse did."""

import ast
import atexit
import json
import os
import queue
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
from get_browser import find
from jupyter_client import BlockingKernelClient
from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 120
"""Seconds after which something that should happen is taken not to: a busy machine is slow."""
VOILA = "--ServerApp.jpserver_extensions={'voila.server_extension': True}"
FLAGS = [  # software rendering, and nothing that calls home
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--disable-background-networking", "--no-first-run"),
    *("--disable-component-update", "--disable-sync", "--disable-quic"),
]
CELLS_RUN = """() => {
  const error = document.querySelector('[data-mime-type="application/vnd.jupyter.error"]');
  if (error) return error.textContent;
  const prompts = [...document.querySelectorAll('.jp-CodeCell .jp-InputPrompt')];
  return prompts.length > 0 && prompts.every(e => /\\[\\d+\\]/.test(e.textContent)); }"""
NO_CELL_RUN = """() => [...document.querySelectorAll('.jp-CodeCell .jp-InputPrompt')].every(
  e => /\\[ *\\]/.test(e.textContent))"""
ECHO = """
import anywidget as _anywidget

class _Echo(_anywidget.AnyWidget):
    _esm = '''export default { initialize({ model }) {
      const drawn = () => new Promise(requestAnimationFrame);
      model.on("msg:custom", ({ call }) => drawn().then(drawn).then(() => model.send({ call })));
    } };'''
    heard = 0

    def answer(self, _, message, __):
        self.heard = max(self.heard, message["call"])

_echo = _Echo()
_echo.on_msg(_echo.answer)
"""


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
        config = [f"--config={ROOT / 'app' / 'jupyter_server_config.py'}"] if no_delay else []
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
        self._wait(lambda: self._get("/api") is not None, PATIENCE, f"{app} did not start")
        self.browser = _playwright().chromium.launch(executable_path=find(), args=FLAGS)
        self.page = self.browser.new_page(viewport={"width": 1400, "height": 1000})
        self.page.set_default_timeout(1000 * PATIENCE)
        self.errors = []  # what the page complains of, for the message of a test that fails
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", self._note)
        self.client = None

    def _note(self, message):
        if message.type == "error":
            self.errors.append(message.text)

    def _get(self, path):
        try:
            with urllib.request.urlopen(
                f"{self.base}{path}?token={self.token}", timeout=PATIENCE
            ) as reply:
                return json.load(reply)
        except OSError:
            return None

    def _wait(self, done, seconds, complaint):
        end = time.time() + seconds
        while not (result := done()):
            if time.time() > end or self.server.poll() is not None:
                log = self.folder / "server.log"
                raise TimeoutError(f"{complaint}; server log: {log}; page: {self.errors}")
            time.sleep(0.1)
        return result

    def open(self, notebook, seconds=300):
        """Open a notebook, run all of it, wait until the kernel is quiet."""
        shutil.copy(notebook, self.folder)
        page, name = self.page, Path(notebook).name
        path = {"jupyterlab": "/lab/tree/", "notebook": "/notebooks/", "voila": "/voila/render/"}
        address = f"{self.base}{path[self.app]}{name}"
        page.goto(f"{address}?reset&token={self.token}", timeout=1000 * seconds)
        (kernel,) = self._wait(lambda: self._get("/api/kernels"), PATIENCE, "no kernel started")
        self.client = BlockingKernelClient()
        self.client.load_connection_file(
            str(self.folder / "runtime" / f"kernel-{kernel['id']}.json")
        )
        self.client.start_channels()
        self._meet_kernel(seconds)
        if self.app != "voila":
            page.wait_for_selector(".jp-Notebook .jp-Cell")
            self.run_cells(seconds)
        return self

    def _choose(self, menu, item):
        self.page.get_by_role("menuitem", name=menu, exact=True).click()
        self.page.get_by_role("menuitem", name=item, exact=True).click()

    def run_cells(self, seconds=300):
        """Run the whole notebook by the menu, wait until the kernel is quiet."""
        self.page.wait_for_selector("[data-status=idle]")  # the page has found its kernel
        self._choose("Run", "Run All Cells")
        end = self._wait(lambda: self.page.evaluate(CELLS_RUN), seconds, "the cells did not run")
        assert end is True, end
        self.settle()

    def restart(self):
        """A new kernel in the same page, by the menu: all that it knew is gone."""
        self._choose("Kernel", "Restart Kernel and Clear Outputs of All Cells…")
        self.page.locator(".jp-Dialog .jp-mod-accept").click()
        self.page.wait_for_function(NO_CELL_RUN)
        self._meet_kernel(PATIENCE)

    def _meet_kernel(self, seconds):
        """Wait until a new kernel answers; what it is asked before it is there gets lost."""

        def answers():
            try:
                self.run("pass", timeout=5)
            except queue.Empty:
                return False
            return True

        self._wait(answers, seconds, "the kernel does not answer")
        self._calls, self._echoes = 0, False

    def bring_into_view(self):
        """Scroll to the first canvas and wait until nothing moves it any more."""
        canvas = self.page.locator("canvas").first
        canvas.wait_for()
        boxes = [None, "none yet"]
        while boxes[-4:] != [boxes[-1]] * 4:  # pictures that come late move the page
            self.settle()
            canvas.scroll_into_view_if_needed()
            boxes.append(canvas.bounding_box())
            assert len(boxes) < 80, "the page does not come to rest"

    def run(self, source, timeout=PATIENCE, **expressions):
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
        """Wait until the page and the kernel have heard each other out, and the page is drawn.

        A call that comes back means that each has heard all that the other sent before it. But a
        widget of the page keeps changes back until the kernel has dealt with its last one: those
        are heard by the second call. What the kernel answers to them is drawn by the third.
        """
        for _ in range(3):
            self._calls += 1
            self._wait(self._called, PATIENCE, "the page does not answer")

    def _called(self):
        """Call the page, once; a page that is still loading may not get to know its first echo."""
        if not self._echoes:
            self.run(ECHO)
        self.run(f"_echo.send({{'call': {self._calls}}})")
        for pause in (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28, 2.56):  # asking costs too
            time.sleep(pause)
            self._echoes = self.run("", heard="_echo.heard")["heard"] >= self._calls
            if self._echoes:
                return True
        return False

    def close(self):
        """End browser, kernel and server."""
        if self.client:
            self.client.stop_channels()
        self.browser.close()
        self.server.terminate()
        self.server.wait(timeout=30)
        self.log.close()


def write_notebook(path, cells):
    """A notebook of these code cells; its folder is made."""
    path.parent.mkdir(exist_ok=True)
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
    code = [nbformat.v4.new_code_cell(cell) for cell in cells]
    nbformat.write(nbformat.v4.new_notebook(cells=code, metadata=kernel), path)
    return path
