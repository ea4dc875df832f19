"""The lab in Chromium: from a mouse move to the new pose in the page, and what 1,000 drags leave.

The canvas is small, so that software rendering does not decide the result. Everything is a
wall-clock time on this machine as busy as it is.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "browser"))
from browser_lab import Lab, Server, write_notebook

CELLS = (
    """
import facelab, numpy as np
from facelab.widgets import PosingLab
example = facelab.load_example()
rig = AREA
corners = [rig.neutral.landmarks[f"mouth_corner_{s}"] for s in ("left", "right")]
samples, control = rig.neutral.subsample(397, keep=corners)
motion = rig.on(samples, control).animate(example.train).with_noise(0.3, 0)
regions = facelab.segment_face(motion.resampled(15), n_regions=10, random_state=0, progress=False)
region = facelab.RegionModel(regions, 30).fit(motion.displacements())
binding = facelab.bind_to_samples(rig.neutral, samples)
session = facelab.PosingSession(region, rig.neutral, binding=binding)
models, takes = {"region": region, "rig": rig}, {"take": motion}
lab = PosingLab(session, models, takes=takes, width=160, height=184)
""",
    "lab",
)

# as the mouse does it, without the mouse: every message goes to the page
DRAGS = """
import os
def drags(n):
    for k in range(n):
        lab._press(corners[k % 2])
        for step in (1, 2, 3):
            lab._move(np.array([0.5, 1.0, 0.2]) * step)
        lab._release()
        if k % 10 == 9:
            lab.session.reset()
def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
"""

PLAYBACK = """
import time
lab.clip.source.value = "take"
frame, start = 0, time.perf_counter()
for frame in range(1, 101):
    lab.clip.slider.value = frame
spent = time.perf_counter() - start
lab.clip.stop.click()
"""

WATCH = """
window.sent = []; window.got = []; window.moves = []; window.drawn = [];
const size = d => d.byteLength ?? d.size ?? d.length;
const real = window.WebSocket;
window.WebSocket = class extends real {
  constructor(...a) {
    super(...a);
    this.addEventListener('message', e => window.got.push(size(e.data)));
  }
  send(d) { window.sent.push(size(d)); super.send(d); }
};
window.addEventListener('pointermove', () => window.moves.push(performance.now()), true);
document.addEventListener('facelab-pull',
  e => e.detail.drawn && window.drawn.push(performance.now()));
"""


def open_lab(folder, area, no_delay):
    """A lab of this face in the page, watched."""
    lab = Lab(Server(folder, no_delay))
    lab.page.add_init_script(WATCH)
    cells = [cell.replace("AREA", area) for cell in CELLS]
    lab.open(write_notebook(Path(folder) / "source" / "latency.ipynb", cells))
    lab.bring_into_view()
    lab.settle()
    return lab


def drag_for(lab, seconds=10.0, every=0.11):
    """Of one long drag: milliseconds to each drawing; bytes and messages each way, a second."""
    at = lab.run("", p="lab.view.project(rig.neutral.vertices[corners[:1]])[0].tolist()")["p"]
    box = lab.page.locator("canvas").first.bounding_box()
    x, y = box["x"] + at[0] * box["width"], box["y"] + at[1] * box["height"]
    mouse = lab.page.mouse
    mouse.move(x, y)
    mouse.down()
    lab.settle()
    lab.page.evaluate("sent.length = got.length = moves.length = drawn.length = 0")
    delays = []
    for k in range(round(seconds / every)):
        lab.page.evaluate("moves.length = drawn.length = 0")
        mouse.move(x + 5 * np.sin(k / 7.3 + 0.2), y - 6 + 5 * np.cos(k / 5.1))
        lab.page.wait_for_timeout(1000 * every)
        moves, drawn = lab.page.evaluate("[moves, drawn]")
        if moves and drawn:
            delays.append(drawn[0] - moves[0])
    got, sent = (np.array(lab.page.evaluate(name)) for name in ("got", "sent"))
    mouse.up()
    lab.settle()
    return np.array(delays), [(sum(way) / seconds, len(way) / seconds) for way in (got, sent)]


def memory(lab):
    """Resident memory of the kernel and used heap of the page after a collection, MB."""
    lab.settle()
    page = lab.page.context.new_cdp_session(lab.page)
    page.send("HeapProfiler.collectGarbage")
    heap = page.send("Runtime.getHeapUsage")["usedSize"] / 2**20
    return lab.run("import gc; _ = gc.collect()", r="resident()")["r"], heap


def print_latency(name, how, delays, traffic):
    (down, n_down), (up, n_up) = traffic
    print(
        f"{name:>8}, {how}: median {np.median(delays):.1f} ms, 95 % "
        f"{np.percentile(delays, 95):.1f} ms ({len(delays)} moves); a second to the page "
        f"{down:.0f} bytes in {n_down:.0f} messages, from it {up:.0f} in {n_up:.0f}",
        flush=True,
    )


def print_growth(lab, n_drags=1000):
    lab.run(DRAGS)
    print("drags   kernel MB   page heap MB")
    done = 0
    for goal in (100, n_drags // 2, n_drags):
        while done < goal:
            lab.run("drags(20)", timeout=300)
            done += 20
        print("{:5d} {:11.1f} {:14.1f}".format(done, *memory(lab)), flush=True)


def main():
    """Print a row for each face and each way of starting the server, memory, and playback."""
    print("from a mouse move to the pose in the page, a drag of 10 s")
    faces = {"example": "example.rig", "9,409": "facelab.load_ict_facekit(area='face')"}
    for name, area in faces.items():
        for no_delay in (True, False):
            with tempfile.TemporaryDirectory() as folder:
                lab = open_lab(folder, area, no_delay)
                try:
                    how = "as make lab starts it" if no_delay else "server as it comes"
                    print_latency(name, how, *drag_for(lab))
                    if no_delay:
                        lab.run("session.use(rig); session.reset()")
                        print_latency(name, "rig, solved in the page", *drag_for(lab))
                        lab.run("session.use(region); session.reset()")
                        spent = lab.run(PLAYBACK, timeout=300, s="spent")["s"]
                        print(f"{name:>8}, take played: {100 / spent:.0f} frames a second leave")
                    if no_delay and name == "example":
                        print_growth(lab)
                finally:
                    lab.close()
                    lab.server.close()


if __name__ == "__main__":
    main()
