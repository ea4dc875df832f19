"""From a step of the alpha slider to the new face having arrived in the page, in Chromium.

The canvases are small, so that software rendering does not decide the result: what is measured is
kernel, server and wire. Beside it, in the same run: what the kernel needs for such a step,
and how long a bare slider needs that changes a word in the page and does nothing else.
"""

import sys
import tempfile
from pathlib import Path

import nbformat
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "browser"))
from browser_lab import Lab, Server

CELL = """
import facelab, numpy as np, time
from facelab.expression.session import ALPHAS, ExpressionSession
from facelab.widgets.expression_lab import ExpressionLab
rig = AREA
rng = np.random.default_rng(0)
w = np.where(rng.uniform(size=len(rig.names)) < 0.15, rng.uniform(0.3, 1, len(rig.names)), 0)
sketch = rig.shape(w) + rng.normal(scale=0.3, size=rig.neutral.vertices.shape)
lab = ExpressionLab(ExpressionSession(rig, sketch), width=150, height=160)
display(lab)
import ipywidgets
bare, word = ipywidgets.IntSlider(tooltip="bare"), ipywidgets.Label()
bare.observe(lambda change: setattr(word, "value", f"bare word {change['new']}"), names="value")
ipywidgets.HBox([bare, word])
"""

WATCH = """
window.sent = []; window.got = []; window.moves = [];
const text = d => typeof d === 'string' ? d : new TextDecoder('latin1').decode(d);
const size = d => d.byteLength ?? d.size ?? d.length;
const real = window.WebSocket;
window.WebSocket = class extends real {
  constructor(...a) {
    super(...a);
    this.addEventListener('message', e => window.got.push(
      [performance.now(), size(e.data), text(e.data).includes('bare word')]));
  }
  send(d) { window.sent.push([performance.now(), size(d)]); super.send(d); }
};
window.addEventListener('keydown', () => window.moves.push(performance.now()), true);
"""

KERNEL = """
took = []
for place in range(30, 70):
    start = time.perf_counter()
    lab.session.set(alpha=float(ALPHAS[place])); lab.session.vertices
    took.append(time.perf_counter() - start)
"""


def measure(area, no_delay, n_moves=60):
    """Milliseconds to the face, to a bare word, and of the kernel alone; bytes of a step."""
    with tempfile.TemporaryDirectory() as folder:
        lab = Lab(Server(folder, no_delay))
        try:
            cell = nbformat.v4.new_code_cell(CELL.replace("AREA", area))
            path = Path(folder) / "source" / "latency.ipynb"
            path.parent.mkdir()
            kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
            nbformat.write(nbformat.v4.new_notebook(cells=[cell], metadata=kernel), path)
            lab.page.add_init_script(WATCH)
            lab.open(path)
            lab.page.locator(".facelab-unit").first.wait_for()
            lab.settle()
            whole = 12 * lab.run("", n="rig.neutral.n_vertices")["n"]
            faces, words, sizes = [], [], []
            for k in range(n_moves):
                for slider in ("alpha", "bare"):
                    focus(lab.page, slider)
                    lab.page.evaluate("sent.length = got.length = moves.length = 0")
                    lab.page.keyboard.press("ArrowRight" if k % 20 < 10 else "ArrowLeft")
                    lab.page.wait_for_timeout(250)
                    (start, *_), got = lab.page.evaluate("moves"), lab.page.evaluate("got")
                    large = [t - start for t, size, _ in got if size >= whole]
                    word = [t - start for t, _, is_word in got if is_word]
                    if slider == "alpha" and large:
                        faces.append(large[-1])  # positions, then normals
                        sizes.append(sum(size for _, size, _ in got))
                    elif word:
                        words.append(word[0])
            took = lab.run(KERNEL, t="np.median(took)")["t"]
            return np.array(faces), np.array(words), 1e3 * took, np.median(sizes)
        finally:
            lab.close()
            lab.server.close()


def focus(page, slider):
    """Give a slider the keyboard."""
    if slider == "alpha":
        page.get_by_label("alpha", exact=True).focus()
    else:
        page.locator(".widget-hslider .noUi-handle").last.focus()


def main():
    """Print a row for each face and each way of starting the server."""
    print("from a step of the alpha slider to the face in the page, 60 steps; aim: under 60 ms")
    for name, area in (
        ("example", "facelab.load_example().rig"),
        ("9,409", "facelab.load_ict_facekit(area='face')"),
    ):
        for no_delay in (True, False):
            faces, words, took, size = measure(area, no_delay)
            how = "as make lab starts it" if no_delay else "server as it comes"
            print(
                f"{name:>8}, {how}: face there after {np.median(faces):.1f} ms (median), "
                f"{np.percentile(faces, 95):.1f} ms (95 %, {len(faces)} steps), "
                f"{size / 1e3:.0f} kB; a bare word after {np.median(words):.1f} ms "
                f"({len(words)} steps), so the lab adds {np.median(faces) - np.median(words):.1f}; "
                f"the kernel alone, lab and all, {took:.1f} ms",
                flush=True,
            )


if __name__ == "__main__":
    main()
