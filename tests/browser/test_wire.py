"""Pulls over a slow wire end where slow pulls over a quick one end, and are drawn as soon."""

import time

import numpy as np
import pytest
from browser_lab import PATIENCE, Lab, wait_until, write_notebook
from playwright.sync_api import expect
from wire import Wire

CELLS = (
    """
import numpy as np
from facelab.expression.session import ExpressionSession
from facelab.widgets import ExpressionLab, PosingLab
lab = PosingLab.example(width=235, height=270)
session, view = lab.session, lab.view
lab""",
    """
rig = lab.models["rig"]
small = rig.on(*session.neutral.subsample(397))
sketch = ExpressionLab(ExpressionSession(small, small.shape([0.3] + [0] * (len(small.names) - 1))))
sketch""",
)
FRESH = {
    "region": "session.use(lab.models['region']); session.set(limit=None); session.reset()",
    "rig": "session.use(lab.models['rig']); session.reset()",
    "limit": "session.use(lab.models['region']); session.set(limit=1.0); session.reset()",
    "expression": "while sketch.session.can_undo: sketch.session.undo()",
}
WATCH = """
window.sent = []; window.late = [];
const real = window.WebSocket;
window.WebSocket = class extends real {
  send(data) { window.sent.push(performance.now()); super.send(data); }
};
let moved = 0;
window.addEventListener("pointermove", () => (moved = performance.now()), true);
document.addEventListener("facelab-pull", ({ detail }) => {
  if (detail.drawn && moved) window.late.push(performance.now() - moved);
});
"""
DRAWN = """(k) => {
  const { skin } = document.querySelectorAll(".facelab-face")[k].facelab;
  return [...skin.X.slice(0, 3 * skin.n)]; }"""
SLIDES = "() => Boolean(document.querySelector('.facelab-face').facelab.sliding())"
QUICK, SLOW = 0.1, 3.0
OFFSET = np.array([22.0, -30.0])  # pixels


class Puller:
    """A lab behind a wire, and a hand that always makes the same pull, at any pace."""

    def __init__(self, lab, wire):
        self.lab, self.wire = lab, wire

    def begin(self, cell):
        """Run a cell up to its line `begun()`."""
        sign = self.lab.folder / "begun"
        sign.unlink(missing_ok=True)
        begun = f"def begun():\n    open({str(sign)!r}, 'w').close()\n"
        self.lab.client.execute(begun + cell, silent=True)
        self.lab.server.wait(sign.exists, PATIENCE, "the cell did not begin")

    def _place(self, kind):
        """Which canvas is pulled, and where, pixels of the page."""
        expression = kind == "expression"
        which = "sketch.sketch_view" if expression else "view"
        canvas = self.lab.page.locator(".facelab-face canvas").nth(int(expression))
        box = self.lab.bring_into_view(canvas)
        vertex = (
            "sketch.session.rig.neutral.vertices[:, 2].argmax()"
            if expression
            else "session.neutral.landmarks['mouth_corner_left']"
        )
        at = self.lab.run("", p=f"{which}.project({which}.vertices[[{vertex}]])[0].tolist()")["p"]
        corner = np.array([box["x"], box["y"]])
        return int(expression), corner + np.array(at) * [box["width"], box["height"]]

    def _seen(self, kind, canvas):
        """The face that the page draws, and the one that the kernel has, (n_vertices, 3)."""
        shown = "sketch.session.sketch" if kind == "expression" else "session.vertices"
        pose = np.array(self.lab.run("", v=f"{shown}.tolist()")["v"])
        return np.reshape(self.lab.page.evaluate(DRAWN, canvas), (-1, 3)), pose

    def pull(self, kind, seconds, delay, look=False, cell=None):
        """A pull that takes so long with the wire so slow, and while a cell runs if one is given.

        With `look`, what the page draws is held against the kernel before it is let go.

        Returns
        -------
        drawn, pose : ndarray of shape (n_vertices, 3)
            What the page showed at the end of it, and what the kernel made of it.
        late, sent : ndarray
            From each move to its drawing, and when messages left the page, milliseconds.
        """
        self.wire.delay = 0.0
        self.lab.run(FRESH[kind])
        canvas, start = self._place(kind)
        mouse, page = self.lab.page.mouse, self.lab.page
        mouse.move(*start)
        self.lab.settle()
        page.evaluate("sent.length = late.length = 0")
        self.wire.delay = delay
        if cell:
            self.begin(cell)
        mouse.down()
        began, steps = time.monotonic(), max(1, round(seconds / 0.06))
        for k in range(1, steps + 1):
            mouse.move(*(start + OFFSET * k / steps))
            page.wait_for_timeout(max(0, 1000 * (began + seconds * k / steps - time.monotonic())))
        if look:
            self.lab.settle()
            drawn, pose = self._seen(kind, canvas)
            assert np.abs(drawn - pose).max() < 0.005, "the page draws another face"
        mouse.up()
        late, sent = (np.array(page.evaluate(name)) for name in ("late", "sent"))
        self.lab.settle()
        drawn, pose = self._seen(kind, canvas)
        view = "sketch.sketch_view" if kind == "expression" else "view"
        sent_last = np.array(self.lab.run("", v=f"{view}.vertices.tolist()")["v"])
        # which is the pose, but for lids that are held off the eyes
        assert np.abs(drawn - sent_last).max() < 0.001, "the page keeps what it drew itself"
        return drawn, pose, late, sent


@pytest.fixture(scope="module")
def puller(server):
    wire = Wire(server.port)
    lab = Lab(server, port=wire.port)
    lab.page.add_init_script(WATCH)
    try:
        lab.open(write_notebook(lab.folder / "source" / "wire.ipynb", CELLS))
        yield Puller(lab, wire)
    finally:
        lab.close()
        wire.close()


def check(puller, kind, seconds, delay, slow, **kwargs):
    _, pose, late, sent = puller.pull(kind, seconds, delay, **kwargs)
    assert np.abs(slow - pose).max() < 0.01, f"{seconds} s at {delay} s one way"
    within = [np.count_nonzero((sent >= t) & (sent < t + 1000)) for t in sent]
    assert max(within) <= 10, "more than 10 messages a second"
    return late


@pytest.mark.parametrize("kind", ["region", "rig"])
def test_a_flick_over_any_wire_ends_where_a_slow_pull_ends(puller, kind):
    _, slow, _, _ = puller.pull(kind, 0.6, 0.0, look=True)
    rest = np.array(puller.lab.run("", v="session.neutral.vertices.tolist()")["v"])
    assert np.abs(slow - rest).max() > 3
    for delay in (0.0, 0.2):
        check(puller, kind, QUICK, delay, slow)


UNTIL_A_STEP = """
import time
state, end = session.state, time.monotonic() + 60
begun()
while session.state is state and time.monotonic() < end:
    time.sleep(0.05)
meanwhile = session.state is not state
"""


def test_flicks_and_buttons_are_answered_while_a_cell_runs(puller):
    lab = puller.lab
    _, slow, _, _ = puller.pull("region", 0.6, 0.0)
    for delay in (0.0, 0.2):
        check(puller, "region", QUICK, delay, slow, cell=UNTIL_A_STEP)
        assert lab.run("", done="meanwhile")["done"]
    while_it_speaks = "while session.undo(): pass\nsession.redo()\n"  # to the button, of can_undo
    puller.begin(while_it_speaks + UNTIL_A_STEP)
    lab.page.get_by_role("button", name="Undo").first.click()
    lab.settle()
    assert lab.run("", done="meanwhile")["done"]


@pytest.mark.parametrize("name, words", [("beta", "Regions agree"), ("gamma", "Stay close")])
def test_the_page_draws_what_beta_and_gamma_do(puller, name, words):
    lab, page = puller.lab, puller.lab.page
    puller.wire.delay = 0.0
    lab.run(
        FRESH["region"] + "; session.set(beta=0.5, gamma=0.025)\n"
        "corner = session.neutral.landmarks['mouth_corner_left']\n"
        "session.pull(corner, session.neutral.vertices[corner] + [4, 7, 0])\n"
        f"slider = lab.pose.{name}"
    )
    lab.bring_into_view()
    slider = page.locator(".widget-inline-hbox", has_text=words).first.locator(".noUi-handle")
    box = slider.bounding_box()
    at = np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
    page.mouse.move(*at)
    page.mouse.down()
    page.wait_for_function(SLIDES)
    before = np.array(page.evaluate(DRAWN, 0))
    puller.wire.delay = 3.0  # from here on the kernel hears nothing for a while
    page.mouse.move(*(at + [25, 0]))
    page.mouse.move(*(at + [35, 0]))
    drawn = np.array(page.evaluate(DRAWN, 0))
    puller.wire.delay = 0.0
    page.mouse.up()
    page.wait_for_function(f"() => !({SLIDES})()")
    lab.settle()
    moved = np.abs(drawn - before).max()
    _, pose = puller._seen("region", 0)
    assert moved > 0.3, "the page waited for the kernel"
    assert np.abs(drawn.reshape(-1, 3) - pose).max() < 0.01 * moved + 0.005
    assert np.abs(np.reshape(page.evaluate(DRAWN, 0), (-1, 3)) - pose).max() < 0.001
    assert lab.run("", made=f"session.{name} != {0.5 if name == 'beta' else 0.025}")["made"]


def test_frames_that_are_on_their_way_when_a_clip_is_stopped_are_not_shown(puller):
    lab = puller.lab
    puller.wire.delay = 0.0
    lab.run(
        "session.reset(); keys = lab.clip; keys.length.value = 60\n"
        "for keys.slider.value in (0, 50): keys.stop.click(); keys.key.click()\n"
        "keys.slider.value = 0; keys.stop.click()"
    )
    lab.settle()
    puller.wire.delay = 0.7  # more than a second until the page has heard and answered
    lab.run("keys.play.playing = True")
    wait_until(lab, "lab.frame is not None and keys.seconds > 0.3")
    lab.run("keys.stop.click(); stopped = keys.seconds")
    lab.settle()
    assert lab.run("", gone_on="keys.seconds > stopped")["gone_on"]
    assert lab.run("", pose="lab.frame is None")["pose"]
    puller.wire.delay = 0.0
    lab.run("keys.slider.value = 25")
    assert lab.run("", frame="lab.frame is not None")["frame"]
    lab.run("keys.stop.click(); keys.set_clip(None); keys.length.value = 3")


@pytest.fixture
def slow(puller):
    """A wire over which messages take their time until `settle` is called, a lab with two poses."""
    lab = puller.lab
    puller.wire.delay = 0.0
    lab.run(
        FRESH["region"] + "\nsession.set(beta=0.5, gamma=0.025)\n" + FRESH["expression"] + "\n"
        "import tempfile\nfrom pathlib import Path\n"
        "lab.strip.path = Path(tempfile.mkdtemp()) / 'poses.library.json'\n"
        "lab.strip._items = {'neutral': lab.strip.poses['neutral']}\n"
        "corner = session.neutral.landmarks['mouth_corner_left']\n"
        "session.pull(corner, session.neutral.vertices[corner] + [2, 4, 0]); lab.strip.add('smile')"
    )
    lab.settle()

    def settle():
        puller.wire.delay = 0.0
        lab.settle()

    puller.wire.delay, puller.settle = 0.3, settle
    yield puller
    settle()


def show_tab(lab, name, k=0):
    lab.page.locator(".facelab-lab").nth(k).locator(".lm-TabBar-tabLabel", has_text=name).click()


def press(control, key, times):
    """A key, pressed quicker than the wire passes it on."""
    control.focus()
    for _ in range(times):
        control.page.keyboard.press(key)


def handle(lab, label):
    return lab.page.get_by_role("slider", name=label, exact=True).first


def test_what_is_done_next_overtakes_nothing_that_a_slow_wire_keeps_back(slow):
    lab, page = slow.lab, slow.lab.page
    show_tab(lab, "Poses")
    name = page.get_by_placeholder("name of the pose").first
    name.press_sequentially("grin")
    name.press("Enter")
    wait_until(lab, "len(lab.strip.poses) > 2")
    press(handle(lab, "blend"), "ArrowRight", 6)
    page.get_by_role("button", name="Add", exact=True).first.dblclick()
    slow.settle()
    assert lab.run("", p="list(lab.strip.poses)")["p"] == ["neutral", "smile", "grin", "pose 1"]
    assert lab.run("", s="lab.strip.share.value")["s"] == 0.06
    assert lab.run("", s="lab.strip.poses['pose 1'].same(session.state)")["s"]
    show_tab(lab, "Pins")
    slow.wire.delay = 0.3
    press(handle(lab, "Stay close γ"), "ArrowRight", 5)
    page.keyboard.press("z")
    slow.settle()
    assert lab.run("", g="session.gamma")["g"] == 0.025
    for _ in range(3):
        page.keyboard.down("p")  # after the first, as a key that is held down
    page.keyboard.up("p")
    slow.settle()
    assert len(lab.run("", p="list(lab.strip.poses)")["p"]) == 5


def test_keys_pressed_quicker_than_the_wire_all_count_and_what_is_shown_is_so(slow):
    lab, page = slow.lab, slow.lab.page
    lab.run("w = dict(zip(sketch.session.names, sketch.session.weights)); n = next(iter(w))")
    unit = page.locator(".facelab-unit-bar").first
    press(unit, "ArrowRight", 4)
    undo = page.locator(".facelab-lab").nth(1).get_by_role("button", name="Undo")
    undo.click()
    slow.settle()
    told = lab.run("", w="sketch.session.state.locked[n] - w[n]")["w"]
    assert told == pytest.approx(0.15, abs=0.006)
    lab.run("sketch.session.set(alpha=2.0)")
    lab.settle()
    slow.wire.delay = 0.3
    page.get_by_role("button", name="Best α").click()
    alpha = page.get_by_label("alpha", exact=True)
    press(alpha, "ArrowLeft", 3)
    slow.settle()
    shown = float(alpha.evaluate("e => e.value"))
    assert shown**2 == pytest.approx(lab.run("", a="sketch.session.alpha")["a"], abs=0.02)
    assert lab.run("", a="sketch.session.state.alpha is not None")["a"]


def test_a_key_moves_as_often_as_asked_and_a_double_click_takes_out_one(slow):
    lab, page = slow.lab, slow.lab.page
    lab.run(
        "keys = lab.clip; keys.set_clip(None)\n"
        "for keys.slider.value in (0, 25, 50): keys.key.click()\n"
        "keys.stop.click()"
    )
    show_tab(lab, "Time")
    key = page.locator(".facelab-track-key").nth(1)
    press(key, "ArrowRight", 4)
    slow.settle()
    assert lab.run("", t="keys.track.times")["t"] == [0, 1.16, 2]
    rows = page.locator("[aria-label='Key poses'] .facelab-item")
    remove = rows.first.get_by_label("Remove this key").bounding_box()
    spot = remove["x"] + 5, remove["y"] + 5
    page.mouse.click(*spot)
    expect(rows).to_have_count(2)  # and the second click of two finds another row there
    page.mouse.down(click_count=2)
    page.mouse.up(click_count=2)
    slow.settle()
    assert lab.run("", t="keys.track.times")["t"] == [1.16, 2]
    page.mouse.down()
    lab.run("keys.keys.items = [{**item, 'note': 'now'} for item in keys.keys.items]")
    lab.settle()
    page.mouse.up()
    slow.settle()
    assert lab.run("", t="keys.track.times")["t"] == [2]
    lab.run("keys.set_clip(None)")


@pytest.mark.long
@pytest.mark.parametrize("kind", FRESH)
def test_pulls_of_any_pace_over_any_wire_end_alike_and_are_drawn_as_soon(puller, kind):
    _, slow, late, _ = puller.pull(kind, SLOW, 0.0, look=True)
    soon = np.median(late)
    for delay in (0.0, 0.1, 0.2):
        for seconds in (QUICK, 0.3, 1.0, SLOW):
            late = check(puller, kind, seconds, delay, slow)
            if seconds == SLOW:
                assert abs(np.median(late) - soon) < 20, "a slow wire delays the drawing"
