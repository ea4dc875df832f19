"""Pictures of README, by hand and mouse: `make pictures`.

Five poses are made in JupyterLab by a mouse that drags as slowly as a hand. Each says how many
pulls it took, how many pins stand at its end, how long the mouse was down and how long all took.
"""

import io
import sys
import tempfile
import time

import matplotlib.pyplot as plt
import numpy as np
from browser_lab import ROOT, Lab, Server, write_notebook
from test_posing_lab import landmark, on_page, vertices

DOCS = ROOT / "docs"
POSING = "from facelab.widgets import PosingLab\nlab = PosingLab.example()\nlab"
EXPRESSION = """
import facelab, numpy as np
from facelab.expression.session import ExpressionSession
from facelab.widgets.expression_lab import ExpressionLab
rig = facelab.load_example().rig
smile = dict(mouthSmile_L=0.9, mouthSmile_R=0.8, browInnerUp_L=0.7, browInnerUp_R=0.7)
face = rig.shape(smile)
sketch = face + np.random.default_rng(0).normal(0, 0.5, face.shape)
lab = ExpressionLab(ExpressionSession(rig, sketch, origin="a smile"), {"a smile": sketch})
lab
"""
POSES = {  # on both sides or not; landmark, and the way to the left and up, millimetres
    "wink with a smirk": (
        False,
        [
            ("eye_left_lower_outer", 0, 1),
            ("eye_left_upper_inner", 0, -8),
            ("mouth_corner_left", 5, 6),
        ],
    ),
    "broad smile": (True, [("mouth_corner_left", 9, 8), ("lip_lower", 0, -4)]),
    "frown": (
        True,
        [("brow_left_1", -2, -4), ("brow_left_3", -1, -3), ("mouth_corner_left", 0, -6)],
    ),
    "oo": (True, [("mouth_corner_left", -10, 0), ("mouth_inner_lower", 0, -3)]),
    "symmetric smile": (True, [("mouth_corner_left", 6, 6)]),
}
"""Region model, and the values of beta and gamma that the lab starts with."""
MOVES, BETWEEN = 15, 1 / 30
"""Of the mouse in one pull, and seconds between them."""


def opened(server, name, cell):
    """A page in the light theme with a notebook of one cell that has run: Lab."""
    lab = Lab(server)
    lab.page.emulate_media(color_scheme="light")
    lab.open(write_notebook(server.folder / "source" / f"{name}.ipynb", [cell]))
    lab.bring_into_view()
    return lab


def drag(lab, name, across, up):
    """Pull a landmark from where it is now; seconds from press to release."""
    start = vertices(lab)[landmark(lab, name)]
    path = start + np.linspace(0, 1, MOVES + 1)[:, None] * [across, up, 0]
    first, *rest = on_page(lab, path)
    lab.page.mouse.move(*first)
    lab.page.wait_for_timeout(150)
    began = time.perf_counter()
    lab.page.mouse.down()
    for spot in rest:
        lab.page.mouse.move(*spot)
        lab.page.wait_for_timeout(1000 * BETWEEN)
    lab.page.mouse.up()
    took = time.perf_counter() - began
    lab.settle()
    return took


def canvas(lab):
    """The picture of the first canvas, without the buttons over it."""
    shot = lab.page.locator("canvas").first.screenshot(style=".facelab-hand { visibility: hidden }")
    return plt.imread(io.BytesIO(shot))


def five_poses(lab):
    """Make each pose from the neutral: dict of name to (picture, line to print)."""
    made = {}
    for name, (both, pulls) in POSES.items():
        lab.run(f"lab.session.reset(); lab.session.symmetric = {both}")
        lab.settle()
        began = time.perf_counter()
        down = sum(drag(lab, *each) for each in pulls)
        took = time.perf_counter() - began
        pins = lab.run("", n="len(lab.session.pins)")["n"]
        count = f"{len(pulls)} pull{'s' * (len(pulls) > 1)}, {pins} pins"
        line = f"{count}, mouse down {down:.1f} s, {took:.1f} s in all"
        print(f"{name}: {line}", flush=True)
        made[name] = canvas(lab), line
    return made


def draw(made, path):
    """The poses in a row, under their names."""
    figure, axes = plt.subplots(1, len(made), figsize=(2.4 * len(made), 3.2), layout="constrained")
    for ax, (name, (picture, line)) in zip(axes, made.items(), strict=True):
        ax.imshow(picture)
        ax.set_title(f"{name}\n{line.split(' s, ')[0]} s", fontsize=8)
        ax.set_axis_off()
    figure.savefig(path, dpi=100, bbox_inches="tight")


def main(folder):
    server = Server(folder)
    try:
        lab = opened(server, "posing", POSING)
        draw(five_poses(lab), DOCS / "five_poses.png")
        lab.run("lab.session.reset(); lab.session.symmetric = False")
        for pull in POSES["wink with a smirk"][1]:
            drag(lab, *pull)
        picture_of(lab, DOCS / "posing.png")
        lab.close()
        lab = opened(server, "expression", EXPRESSION)
        picture_of(lab, DOCS / "expression.png")
        lab.close()
    finally:
        server.close()


def picture_of(lab, path):
    """The whole lab, as the page shows it."""
    lab.page.mouse.move(2, 2)
    lab.settle()
    lab.page.locator(".facelab-lab").first.screenshot(path=str(path))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(main(folder))
