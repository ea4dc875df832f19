"""A real Jupyter in a real Chromium, with a way to ask the kernel what the mouse did."""

import ast
import atexit
import json
import os
import queue
import re
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
from playwright.sync_api import TimeoutError as PlaywrightTimeoutError
from playwright.sync_api import expect, sync_playwright

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 120
"""Seconds after which something that should happen is taken not to: a busy machine is slow."""
expect.set_options(timeout=1000 * PATIENCE)
FLAGS = [  # software rendering, and nothing that calls home
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--disable-background-networking", "--no-first-run"),
    *("--disable-component-update", "--disable-sync", "--disable-quic"),
]
NOT_OURS = re.compile(  # what pythreejs, JupyterLab and the server say by themselves
    r"t\.on is not a function|Failed to load resource|WebSocket|widget model not found"
    # anywidget, of a page too busy to start its parts in two seconds: they hear the kernel anyhow
    r"|\[anywidget\] Failed to initialize model"
    # and Notebook and Voila, which do not have all that JupyterLab's extensions ask for
    r"|getter for the shared module|reading 'schema'|'filebrowser:open-path' not registered"
)
CELLS_RUN = """() => {
  const error = document.querySelector('[data-mime-type="application/vnd.jupyter.error"]');
  if (error) return error.textContent;
  const prompts = [...document.querySelectorAll('.jp-CodeCell .jp-InputPrompt')];
  return prompts.length > 0 && prompts.every(e => /\\[\\d+\\]/.test(e.textContent)); }"""
NO_CELL_RUN = """() => [...document.querySelectorAll('.jp-CodeCell .jp-InputPrompt')].every(
  e => /\\[ *\\]/.test(e.textContent))"""
ECHO = """
from facelab.widgets.in_touch import InTouch as _InTouch, script as _script

class _Echo(_InTouch):
    _esm = _script() + '''export default { initialize({ model }) {
      stayInTouch({ model });
      const drawn = () => new Promise(requestAnimationFrame);
      model.on("msg:custom", async ({ call, draw, again }) => {
        if (draw) await drawn().then(drawn);
        model.send({ call, again });
        if (again) window.called = call;
      });
    } };'''
    heard = 0

    def answer(self, _, message, __):
        call, again = message["call"], message.get("again")
        if again:
            self.heard = max(self.heard, call)
        else:
            self.send({"call": call, "again": True})

_echo = _Echo()
_echo.on_msg(_echo.answer)
"""


@cache
def _browser():
    """One for all labs of a run: there cannot be two playwrights."""
    started = sync_playwright().start()
    atexit.register(started.stop)
    return started.chromium.launch(executable_path=find(), args=FLAGS)


def new_page():
    """A page of that browser that shows nothing yet."""
    page = _browser().new_page(viewport={"width": 1400, "height": 1000})
    page.set_default_timeout(1000 * PATIENCE)
    return page


class Server:
    """A server started as `make lab` starts it, for any number of labs.

    Parameters
    ----------
    folder : Path
        Where it runs; notebooks are copied there.
    no_delay : bool
        Whether to use the lab's own server configuration.
    """

    def __init__(self, folder, no_delay=True):
        self.folder = Path(folder)
        self.token = secrets.token_hex(16)
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            self.port = s.getsockname()[1]
        env = {**os.environ, "JUPYTER_RUNTIME_DIR": str(self.folder / "runtime")}
        env["JUPYTERLAB_SETTINGS_DIR"] = str(self.folder / "settings")  # not the person's own
        root = [] if no_delay else ["--allow-root"]  # the lab's own configuration sees to it
        config = [f"--config={ROOT / 'app' / 'jupyter_server_config.py'}"] if no_delay else []
        self.log = open(self.folder / "server.log", "w")
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", "jupyterlab", *config, "--no-browser", *root),
                *(f"--port={self.port}", "--ServerApp.port_retries=0"),
                *(f"--IdentityProvider.token={self.token}", f"--ServerApp.root_dir={self.folder}"),
            ],
            stdout=self.log,
            stderr=self.log,
            env=env,
        )
        self.wait(lambda: self.ask("/api") is not None, PATIENCE, "the server did not start")

    def ask(self, path, method="GET"):
        """What the server answers, or None."""
        address = f"http://127.0.0.1:{self.port}{path}"
        head = {"Authorization": f"token {self.token}"}
        request = urllib.request.Request(address, headers=head, method=method)
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE) as reply:
                return json.loads(reply.read() or "null")
        except OSError:
            return None

    def kernels(self):
        """Those that run: set of their names."""
        return {kernel["id"] for kernel in self.ask("/api/kernels") or []}

    def wait(self, done, seconds, complaint):
        """Wait for something to come true; give what it gave."""
        end = time.time() + seconds
        while not (result := done()):
            if time.time() > end or self.process.poll() is not None:
                raise TimeoutError(f"{complaint}; server log: {self.folder / 'server.log'}")
            time.sleep(0.05)
        return result

    def close(self):
        """End it, and its kernels with it."""
        self.process.terminate()
        self.process.wait(timeout=30)
        self.log.close()


LABS = []
"""Every `Lab` of the run."""


class Lab:
    """One notebook open in one page.

    Parameters
    ----------
    server : Server
    app : {"jupyterlab", "notebook", "voila"}
        What shows the notebook; Voila as `make app` starts it.
    port : int, optional
        Of a `Wire` to the server.
    """

    def __init__(self, server, app="jupyterlab", port=None):
        self.server, self.app, self.folder = server, app, server.folder
        self.base = f"http://127.0.0.1:{port or server.port}"
        self.page = new_page()
        self.errors = []  # what the page complains of, for the message of a test that fails
        self._heard_of = 0
        LABS.append(self)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", self._note)
        self.client = self._kernel = None

    def _note(self, message):
        if message.type == "error":
            self.errors.append(message.text)

    def complaints(self):
        """What the page has complained of since this was last asked, and is ours: list of str."""
        new, self._heard_of = self.errors[self._heard_of :], len(self.errors)
        return [error for error in new if not NOT_OURS.search(error)]

    def _wait(self, done, seconds, complaint):
        try:
            return self.server.wait(done, seconds, complaint)
        except TimeoutError as error:
            raise TimeoutError(f"{error}; page: {self.errors}") from None

    def open(self, notebook, seconds=300):
        """Open a notebook, run all of it, wait until the kernel is quiet."""
        shutil.copy(notebook, self.folder)
        page, name = self.page, Path(notebook).name
        self.name = name
        path = {"jupyterlab": "/lab/tree/", "notebook": "/notebooks/", "voila": "/voila/render/"}
        address = f"{self.base}{path[self.app]}{name}"
        others = self.server.kernels()
        page.goto(f"{address}?reset&token={self.server.token}", timeout=1000 * seconds)
        new = self._wait(lambda: self.server.kernels() - others, PATIENCE, "no kernel started")
        (self._kernel,) = new
        self.client = BlockingKernelClient()
        self.client.load_connection_file(
            str(self.folder / "runtime" / f"kernel-{self._kernel}.json")
        )
        self.client.start_channels()
        self._meet_kernel(seconds)
        if self.app != "voila":
            page.wait_for_selector(".jp-Notebook .jp-Cell")
            self.run_cells(seconds)
        return self

    def _choose(self, menu, item):
        self.page.get_by_role("menuitem", name=menu, exact=True).click()
        label = re.compile(f"^{re.escape(item)}$")  # what is pressed for it stands beside it
        self.page.locator(".lm-Menu-itemLabel", has_text=label).click()

    def run_cells(self, seconds=300):
        """Run the whole notebook by the menu, wait until the kernel is quiet."""
        self.page.wait_for_selector("[data-status=idle]")  # the page has found its kernel
        self._choose("Run", "Run All Cells")
        end = self._wait(lambda: self.page.evaluate(CELLS_RUN), seconds, "the cells did not run")
        assert end is True, end
        self.settle()

    def restart(self, clear=True):
        """A new kernel in the same page, by the menu: all that it knew is gone."""
        words = "Restart Kernel and Clear Outputs of All Cells…" if clear else "Restart Kernel…"
        self._choose("Kernel", words)
        self.page.locator(".jp-Dialog .jp-mod-accept").click()
        if clear:
            self.page.wait_for_function(NO_CELL_RUN)
        self._meet_kernel(PATIENCE)

    def save(self):
        """Write the notebook with its outputs."""
        path = self.folder / self.name
        before = path.stat().st_mtime_ns
        self._choose("File", "Save Notebook")
        self._wait(lambda: path.stat().st_mtime_ns != before, PATIENCE, "nothing was saved")

    def load(self, name=None):
        """Load the page anew, or that of another notebook of the folder; nothing is run."""
        self._calls, self._echoes = 0, False
        address = f"/lab/tree/{name}?reset&token={self.server.token}"
        self.page.goto(f"{self.base}{address}") if name else self.page.reload()
        self.page.wait_for_selector(".jp-Notebook .jp-Cell")
        self.page.wait_for_selector("[data-status=idle]")

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

    def bring_into_view(self, canvas=None):
        """Scroll to the first canvas, or to this one, and wait until nothing moves it any more."""
        canvas = canvas or self.page.locator("canvas").first
        canvas.wait_for()
        self.settle()
        boxes = []
        while len(boxes) < 3 or boxes[-3:] != [boxes[-1]] * 3:  # late pictures move the page
            canvas.scroll_into_view_if_needed()
            self.page.evaluate("() => new Promise(requestAnimationFrame)")
            boxes.append(canvas.bounding_box())
            assert len(boxes) < 200, "the page does not come to rest"
        return boxes[-1]

    def run(self, source, timeout=PATIENCE, **expressions):
        """Run source in the notebook's kernel; values of expressions come back through JSON."""
        asked = {k: f"__import__('json').dumps({v})" for k, v in expressions.items()}
        # quietly: a page shows what its kernel runs, and on a busy machine that takes its time
        ident = self.client.execute(source, silent=True, user_expressions=asked)
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

        The lab's own parts tell first what they keep back for a moment, such as moves of the mouse.
        A call that comes back means that each has heard all that the other sent before it. It goes
        there and back twice: the kernel hears what answers a cell in one thread, and what answers
        the page's own messages in another. But a widget of the page keeps changes back until the
        kernel has dealt with its last one: those are heard by the second call. What the kernel
        answers to them is drawn by the third.
        """
        self.page.evaluate("document.dispatchEvent(new Event('facelab-tell'))")
        for draw in (False, False, True):
            self._wait(lambda d=draw: self._called(d), PATIENCE, "the page does not answer")
        self.run("pass")  # comes after all that waited beside the last call

    def _called(self, draw):
        """Call the page, once; a page that is still loading may not get to know its first echo.

        Each call has its own number: a late answer to the echo before is none to this one.
        """
        self._calls += 1
        if not self._echoes:
            self.run(ECHO)
            self.page.evaluate("window.called = 0")
        self.run(f"_echo.send({{'call': {self._calls}, 'draw': {draw}}})")
        try:  # the page waits for itself: to ask the kernel again and again costs both
            patience = 1000 * PATIENCE if self._echoes else 3000
            self.page.wait_for_function(f"window.called >= {self._calls}", timeout=patience)
        except PlaywrightTimeoutError:
            return False
        self._echoes = True
        return self._wait(
            lambda: self.run("", heard="_echo.heard")["heard"] >= self._calls, PATIENCE, "no echo"
        )

    def close(self):
        """End page and kernel."""
        if self.client:
            self.client.stop_channels()
        self.page.close()
        if self._kernel:
            self.server.ask(f"/api/kernels/{self._kernel}", "DELETE")


def snapshot(lab, name):
    """Save a picture of the page where FACELAB_PICTURES names a folder."""
    if os.environ.get("FACELAB_PICTURES"):
        lab.page.screenshot(path=str(Path(os.environ["FACELAB_PICTURES"]) / f"{name}.png"))


def wait_until(lab, condition):
    """Wait for a condition in the kernel: a busy machine hears of the mouse late."""
    end = time.time() + PATIENCE
    while not lab.run("", c=f"bool({condition})")["c"]:
        assert time.time() < end, f"{condition} did not come true in {PATIENCE} s"
        lab.page.wait_for_timeout(50)


def write_notebook(path, cells):
    """A notebook of these code cells; its folder is made."""
    path.parent.mkdir(exist_ok=True)
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
    code = [nbformat.v4.new_code_cell(cell) for cell in cells]
    nbformat.write(nbformat.v4.new_notebook(cells=code, metadata=kernel), path)
    return path
