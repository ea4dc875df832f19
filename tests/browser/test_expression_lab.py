"""The expression lab as a person uses it, in JupyterLab: sliders, buttons and bars of the page."""

import numpy as np
import pytest
from browser_lab import Lab, snapshot, wait_until, write_notebook
from playwright.sync_api import expect

CELL = """
import facelab, numpy as np
from facelab.expression.session import ExpressionSession
from facelab.widgets.expression_lab import ExpressionLab
rig = facelab.load_example().rig
small = rig.on(*rig.neutral.subsample(397))
n = len(small.names)
first, second = (small.shape(0.8 * (np.arange(n) % 9 == k)) for k in (2, 5))
session = ExpressionSession(small, first, origin="first")
lab = ExpressionLab(session, {"first": first, "second": second, "broken": first[1:]})
lab
"""


@pytest.fixture(scope="module")
def page_lab(server):
    lab = Lab(server)
    try:
        lab.open(write_notebook(lab.folder / "source" / "expression.ipynb", [CELL]))
        lab.page.locator(".facelab-unit").first.wait_for()
        lab.settle()
        yield lab
    finally:
        lab.close()


def state(lab):
    """Alpha, weights and vertices of the session; as JSON from the kernel."""
    told = lab.run(
        "", a="session.alpha", w="session.weights.tolist()", v="session.vertices.tolist()"
    )
    return told["a"], np.array(told["w"]), np.array(told["v"])


def bar(lab, name):
    """Width of a unit's bar on the page, per cent."""
    row = lab.page.locator(".facelab-unit", has=lab.page.get_by_label(f"lock {name}", exact=True))
    return float(row.locator(".facelab-unit-filled").evaluate("e => parseFloat(e.style.width)"))


def test_alpha_and_locks_move_face_and_bars_and_undo_brings_them_back(page_lab):
    lab, page = page_lab, page_lab.page
    face = page.locator(".jp-OutputArea canvas").nth(1)
    alpha, w, V = state(lab)
    strongest = lab.run("", n="next(iter(session.named))")["n"]
    k = lab.run("", k=f"session.names.index({strongest!r})")["k"]
    assert bar(lab, strongest) == pytest.approx(100 * w[k], abs=0.1)
    before = face.screenshot()
    page.get_by_label("alpha", exact=True).focus()
    for _ in range(25):
        page.keyboard.press("ArrowLeft")
    lab.settle()
    moved_alpha, moved_w, moved_V = state(lab)
    assert moved_alpha < alpha - 1 and np.abs(moved_V - V).max() > 0.5
    assert bar(lab, strongest) == pytest.approx(100 * moved_w[k], abs=0.1)
    assert face.screenshot() != before, "the page shows no change"
    expect(page.get_by_text(f"α = {moved_alpha:g}: sum")).to_be_visible()

    page.get_by_label(f"lock {strongest}", exact=True).click()
    page.get_by_role("button", name="Best α").click()
    lab.settle()
    assert state(lab)[1][k] == pytest.approx(moved_w[k], abs=1e-12), "the lock should hold"
    handle = page.locator(".facelab-unit-bar").nth(k)
    handle.scroll_into_view_if_needed()
    box = handle.bounding_box()
    page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 8)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 8, steps=6)
    page.mouse.up()
    lab.settle()
    assert state(lab)[1][k] == pytest.approx(0.6, abs=0.05), "a bar sets its weight"
    page.get_by_label(f"exclude {strongest}", exact=True).click()
    wait_until(lab, f"session.weights[{k}] == 0")
    lab.settle()
    assert state(lab)[1][k] == 0 and bar(lab, strongest) == 0
    for _ in range(20):
        if page.get_by_role("button", name="Undo").is_enabled():
            page.get_by_role("button", name="Undo").click()
            lab.settle()
    np.testing.assert_array_equal(state(lab)[2], V)


def test_either_face_can_fill_the_screen(page_lab):
    page = page_lab.page
    for k in (0, 1):
        usual = page_lab.bring_into_view()
        page.get_by_label("Full screen").nth(k).click()
        page.wait_for_function("document.fullscreenElement !== null")
        page_lab.settle()
        box = page.locator(".jp-OutputArea canvas").nth(k).bounding_box()
        assert (box["width"], box["height"]) == (1400, 1000)
        page.get_by_label("Full screen").nth(k).click()
        page.wait_for_function("document.fullscreenElement === null")
        after = page_lab.bring_into_view()
        assert (after["width"], after["height"]) == (usual["width"], usual["height"])


def test_another_sketch_is_loaded_pulled_and_a_bad_one_refused_in_the_page(page_lab):
    lab, page = page_lab, page_lab.page
    lab.run("session.free(); session.set(alpha='best'); lab.refresh()")
    sources = page.locator(".jp-OutputArea select").first
    sources.select_option("second")
    lab.settle()
    expected = lab.run("", s="second.tolist()", r="session.rms")
    np.testing.assert_allclose(lab.run("", s="session.sketch.tolist()")["s"], expected["s"])
    assert expected["r"] < 0.1
    _, w, V = state(lab)

    sources.select_option("broken")
    lab.settle()
    expect(page.get_by_text("sketch has shape (396, 3)")).to_be_visible()
    assert sources.input_value() == "second"
    np.testing.assert_array_equal(state(lab)[2], V)

    vertex = lab.run("", v="int(small.neutral.vertices[:, 2].argmax())")["v"]  # the nose
    sketch = page.locator(".jp-OutputArea canvas").first
    sketch.scroll_into_view_if_needed()
    at = lab.run("", p=f"lab.sketch_view.project(session.sketch[[{vertex}]])[0].tolist()")["p"]
    box = sketch.bounding_box()
    x, y = box["x"] + at[0] * box["width"], box["y"] + at[1] * box["height"]
    for key in ("Escape", "z", None):
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x, y + 24, steps=6)
        wait_until(lab, "session.state.origin == 'pulled by hand'")
        if key:
            page.keyboard.press(key)
            wait_until(lab, "not lab.sketch_view.dragging")
            page.mouse.move(x, y + 36, steps=3)
        page.mouse.up()
        lab.settle()
        if key:
            assert lab.run("", o="session.state.origin")["o"] == "second"
            np.testing.assert_array_equal(state(lab)[2], V)
    assert lab.run("", o="session.state.origin")["o"] == "pulled by hand"
    expect(page.get_by_text("sketch has shape")).not_to_be_visible()
    assert np.abs(state(lab)[1] - w).max() > 0.01, "the units should have followed the pull"


TOLD = """() => {
  window.told = []; // when a slider spoke, milliseconds
  const send = WebSocket.prototype.send;
  WebSocket.prototype.send = function (data) {
    if (new TextDecoder().decode(data).includes('"asked"')) window.told.push(performance.now());
    return send.call(this, data);
  };
}"""


def test_lambda_is_slid_by_ten_messages_a_second_at_most_and_ends_where_it_is_let_go(page_lab):
    lab, page = page_lab, page_lab.page
    lab.run("steps = session.n_undo")
    page.evaluate(TOLD)
    page.get_by_role("tab", name="Fit", exact=True).first.click()
    slider = page.get_by_role("slider", name="Hold sum").first
    slider.scroll_into_view_if_needed()
    box = slider.bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.3 * box["width"], y)
    page.mouse.down()
    for step in range(40):
        page.mouse.move(box["x"] + (0.3 + 0.01 * step) * box["width"], y)
        page.wait_for_timeout(20)
    page.mouse.up()
    lab.settle()
    shown = page.get_by_role("spinbutton", name="Hold sum").first.input_value()
    lam, steps = lab.run("", s="[session.state.lam, session.n_undo - steps]")["s"]
    assert f"{lam:g}" == shown and 0.1 < lam < 10 and steps == 1
    told = np.array(page.evaluate("told"))
    assert len(told) > 1
    assert max(np.count_nonzero((told >= t) & (told < t + 1000)) for t in told) <= 10


def test_what_can_be_saved_is_read_to_its_end(page_lab):
    page_lab.page.locator(".lm-TabBar-tabLabel", has_text="Files").first.click()
    text = page_lab.page.get_by_text("Saved beside the notebook")
    expect(text).to_be_visible()
    snapshot(page_lab, "expression_files")
    assert text.evaluate("e => e.scrollWidth <= e.clientWidth"), "the text is cut off"
