"""From a mouse move in the page to the new pose having arrived in the page, in Chromium.

The canvas is small, so that software rendering does not decide the result: what is measured is
kernel, server and wire.
"""

import sys
import tempfile
from pathlib import Path

import nbformat
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "browser"))
from conftest import Lab

CELL = """
import facelab, numpy as np
from facelab.widgets import PosingLab
example = facelab.load_example()
rig = AREA
corners = [rig.neutral.landmarks[f"mouth_corner_{s}"] for s in ("left", "right")]
samples, control = rig.neutral.subsample(397, keep=corners)
motion = rig.on(samples, control).animate(example.train).with_noise(0.3, 0)
regions = facelab.segment_face(motion.resampled(15), n_regions=10, random_state=0, progress=False)
region = facelab.RegionModel(regions, 30).fit(motion.displacements())
session = facelab.PosingSession(region, rig.neutral, binding=facelab.bind(rig.neutral, samples))
lab = PosingLab(session, width=160, height=170)
lab
"""

WATCH = """
window.sent = []; window.got = []; window.moves = [];
const size = d => d.byteLength ?? d.size ?? d.length;
const text = d => typeof d === 'string' ? d : new TextDecoder('latin1').decode(d);
const real = window.WebSocket;
window.WebSocket = class extends real {
  constructor(...a) {
    super(...a);
    this.addEventListener('message', e => window.got.push(
      [performance.now(), size(e.data), text(e.data).includes('morphTargetInfluences')]));
  }
  send(d) { window.sent.push([performance.now(), size(d)]); super.send(d); }
};
window.addEventListener('mousemove', () => window.moves.push(performance.now()), true);
"""


def measure(area, no_delay, n_moves=100):
    """Latencies (ms), bytes and messages of each move."""
    with tempfile.TemporaryDirectory() as folder:
        lab = Lab(folder, no_delay)
        try:
            cell = nbformat.v4.new_code_cell(CELL.replace("AREA", area))
            path = Path(folder) / "source" / "latency.ipynb"
            path.parent.mkdir()
            kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
            nbformat.write(nbformat.v4.new_notebook(cells=[cell], metadata=kernel), path)
            lab.page.add_init_script(WATCH)
            lab.open(path)
            canvas = lab.page.locator(".jp-OutputArea canvas").first
            canvas.scroll_into_view_if_needed()
            lab.page.wait_for_timeout(1500)
            at = lab.run("", p="lab.view.project(rig.neutral.vertices[corners[:1]])[0].tolist()")[
                "p"
            ]
            box = canvas.bounding_box()
            x, y = box["x"] + at[0] * box["width"], box["y"] + at[1] * box["height"]
            mouse = lab.page.mouse
            mouse.move(x - 1, y)
            lab.settle()
            mouse.move(x, y)
            lab.settle()
            mouse.down()
            lab.settle()
            delays, sizes, counts = [], [], []
            for k in range(n_moves):
                lab.page.evaluate("sent.length = got.length = moves.length = 0")
                mouse.move(x + 5 * np.sin(k / 7.3 + 0.2), y - 6 + 5 * np.cos(k / 5.1))
                lab.page.wait_for_timeout(110)
                moves, got, sent = (lab.page.evaluate(n) for n in ("moves", "got", "sent"))
                arrived = [t for t, _, is_pose in got if is_pose]
                if moves and arrived:
                    delays.append(arrived[0] - moves[0])
                    sizes.append(
                        (
                            sum(b for _, b, p in got if p),
                            sum(b for _, b, _ in got),
                            sum(b for _, b in sent),
                        )
                    )
                    counts.append(len(got) + len(sent))
            mouse.up()
            return np.array(delays), np.array(sizes), np.array(counts)
        finally:
            lab.close()


def main():
    """Print a row for each face and each way of starting the server."""
    print("from a mouse move to the pose in the page, 100 moves")
    for name, area in (
        ("example", "example.rig"),
        ("9,409", "facelab.load_ict_facekit(area='face')"),
    ):
        for no_delay in (True, False):
            delays, sizes, counts = measure(area, no_delay)
            how = "as make lab starts it" if no_delay else "server as it comes"
            pose, down, up = np.median(sizes, axis=0)
            print(
                f"{name:>8}, {how}: median {np.median(delays):.1f} ms, 95 % "
                f"{np.percentile(delays, 95):.1f} ms ({len(delays)} moves); to the page "
                f"{pose:.0f} bytes of pose, {down:.0f} in all; from it {up:.0f}; "
                f"{np.median(counts):.0f} messages",
                flush=True,
            )


if __name__ == "__main__":
    main()
