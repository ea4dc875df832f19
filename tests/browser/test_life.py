"""Both labs from first to last: in any theme and size, reloaded, asleep, and before Run."""

import re
import shutil

import numpy as np
import pytest
from browser_lab import Lab, snapshot, write_notebook
from playwright.sync_api import expect

from facelab.course.__main__ import complete

CELLS = (
    """
from facelab.widgets import PosingLab
lab = PosingLab.example(width=320, height=368)
lab""",
    """
from facelab.expression.session import ExpressionSession
from facelab.widgets import ExpressionLab
rig = lab.rig
sketch = rig.shape({name: 0.8 * (k % 9 == 2) for k, name in enumerate(rig.names)})
expression = ExpressionLab(ExpressionSession(rig, sketch, origin="first"), props=lab.props)
expression""",
)


@pytest.fixture(scope="module")
def living(server):
    lab = Lab(server)
    try:
        lab.open(write_notebook(lab.folder / "source" / "life.ipynb", CELLS))
        lab.page.locator(".facelab-unit").first.wait_for()
        lab.bring_into_view()
        yield lab
    finally:
        lab.close()


# Of a lab that has been brought to the top of the page: what is cut off, and pale texts.
LOOK = """lab => {
  lab.scrollIntoView({ block: "start" });
  const page = lab.closest(".jp-WindowedPanel-outer") ?? document.documentElement;
  const room = page.getBoundingClientRect();
  const complaints = [];
  const wide = [lab, page].filter((e) => e.scrollWidth > e.clientWidth + 1);
  if (wide.length) complaints.push("wider than the page");
  const seen = [...lab.querySelectorAll(".facelab-face"), lab.querySelector(".lm-TabBar")];
  for (const part of seen) {
    const box = part.getBoundingClientRect();
    if (box.bottom > room.bottom + 1 || box.right > room.right + 1 || box.width < 100)
      complaints.push(`${part.className} is out of view, ${box.width} x ${box.height}`);
  }
  const buttons = [...lab.querySelectorAll(".widget-button")];
  if (!buttons.every((b) => b.offsetWidth || b.closest(".lm-mod-hidden")))
    complaints.push("a button is not there");
  const paint = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (color) => {
    paint.clearRect(0, 0, 1, 1);
    paint.fillStyle = color;
    paint.fillRect(0, 0, 1, 1);
    return [...paint.getImageData(0, 0, 1, 1).data];
  };
  const light = (c) => {
    const [r, g, b] = c.slice(0, 3).map((x) => x / 255).map((x) =>
      x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (e) => {
    for (; e; e = e.parentElement) {
      const color = rgba(getComputedStyle(e).backgroundColor);
      if (color[3] > 200) return color;
    }
    return [255, 255, 255];
  };
  const texts = "button, .widget-label, .facelab-name, .facelab-status, .facelab-slider-name";
  for (const e of lab.querySelectorAll(texts)) {
    if (!e.checkVisibility() || e.disabled || !e.textContent.trim()) continue;
    if (e.closest(".facelab-views")) continue; // pale until the mouse is there
    const [a, b] = [rgba(getComputedStyle(e).color), behind(e)].map(light).sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 3) complaints.push(`pale (${ratio.toFixed(1)}): ${e.textContent.slice(0, 30)}`);
  }
  return complaints;
}"""

# A page in which no model starts in the time that anywidget gives it.
NO_TIME = """AbortSignal.timeout = () => {
  const ended = new AbortController();
  queueMicrotask(() => ended.abort());
  return ended.signal;
}"""


def test_a_page_too_busy_to_start_its_parts_in_time_still_hears_the_kernel(server):
    lab = Lab(server)
    try:
        lab.page.add_init_script(NO_TIME)
        cells = CELLS[0].replace("320", "200").replace("368", "230")
        lab.open(write_notebook(lab.folder / "source" / "busy.ipynb", [cells]))
        lab.bring_into_view()
        page, pins = lab.page, lab.page.locator(".facelab-pin")
        lab.run(
            "session, face = lab.session, lab.session.neutral\n"
            "v = face.landmarks['mouth_corner_left']\n"
            "session.pull(v, face.vertices[v] + [3, 3, 0])"
        )
        expect(pins).to_have_count(1)
        box = pins.first.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 5, y + 5)
        answered = "document.querySelector('.facelab-face').facelab.drag.answer"
        page.wait_for_function(f"Boolean({answered})")
        page.mouse.up()
        lab.settle()
        assert lab.run("", n="session.n_undo")["n"] == 2
    finally:
        lab.close()


# A page so busy that JupyterLab, which looks for a model ten times a second for two seconds, looks
# but once: before any has come from the kernel.
ONE_LOOK = """const timer = window.setTimeout;
window.setTimeout = (act, delay, ...rest) => timer(act, delay === 100 ? 2100 : delay, ...rest);"""


def test_a_page_too_busy_to_look_for_its_models_in_time_shows_them_after_all(server):
    lab = Lab(server)
    try:
        cells = CELLS[0].replace("320", "200").replace("368", "230")
        lab.open(write_notebook(lab.folder / "source" / "late.ipynb", [cells]))
        lab.save()
        lab.page.add_init_script(ONE_LOOK)
        lab.load()
        lab.page.wait_for_function("document.querySelector('.facelab-face')?.facelab")
        assert lab.page.locator(".facelab-lab").count() == 1
    finally:
        lab.close()


@pytest.mark.parametrize("theme", ["Light", "Dark"])
def test_face_and_controls_of_both_labs_are_in_view_and_legible(living, theme):
    page = living.page
    page.get_by_role("menuitem", name="Settings", exact=True).click()
    page.locator(".lm-Menu-item", has_text="Theme").first.hover()
    label = re.compile(f"^JupyterLab {theme}$")
    page.locator(".lm-Menu-itemLabel", has_text=label).click()
    page.wait_for_function(f"document.body.dataset.jpThemeName === 'JupyterLab {theme}'")
    for size in ((1280, 800), (1100, 700)):
        page.set_viewport_size({"width": size[0], "height": size[1]})
        for k, name in enumerate(("posing", "expression")):
            page.locator(".facelab-lab").nth(k).scroll_into_view_if_needed()
            living.settle()
            found = page.locator(".facelab-lab").nth(k).evaluate(LOOK)
            snapshot(living, f"{name}_{theme.lower()}_{size[0]}")
            assert not found, f"{name} lab at {size}: {found}"
    behind = page.evaluate(
        "[...document.querySelectorAll('.facelab-face')].map("
        "({ facelab }) => facelab.view.scene.background.getHexString())"
    )
    assert set(behind) == {{"Light": "f4f4f2", "Dark": "26282b"}[theme]}
    page.set_viewport_size({"width": 1400, "height": 1000})


DRAWN = """() => { const { skin } = document.querySelector(".facelab-face").facelab;
  return [...skin.X.slice(0, 3 * skin.n)]; }"""


def test_a_reload_of_the_page_shows_the_pose_of_the_kernel_and_goes_on(living):
    page = living.page
    living.run(
        "session, corner = lab.session, lab.mesh.landmarks['mouth_corner_left']\n"
        "session.pull(corner, session.vertices[corner] + [4, 7, 0]); session.look(20, 0)"
    )
    living.save()
    living.load()
    page.wait_for_function("document.querySelector('.facelab-face')?.facelab")
    living.bring_into_view()
    snapshot(living, "reloaded")
    expected = np.ravel(living.run("", v="lab.view.vertices.tolist()")["v"])
    np.testing.assert_allclose(page.evaluate(DRAWN), expected, atol=1e-3)
    expect(page.locator("[aria-label=Pins] .facelab-item").first).to_contain_text("mouth corner")
    for _ in range(2):
        page.get_by_role("button", name="Undo", exact=True).first.click()
        living.settle()
    rest = np.ravel(living.run("", v="session.neutral.vertices.tolist()")["v"])
    np.testing.assert_allclose(page.evaluate(DRAWN), rest, atol=1e-3)


ASLEEP = """() => [...document.querySelectorAll(".facelab-lab")].every(
  (lab) => getComputedStyle(lab, "::before").content.includes("asleep"))"""


def test_a_lab_whose_kernel_was_restarted_is_asleep_and_then_offers_the_pose_again(living):
    page = living.page
    for _ in range(2):  # what is made in the page is kept
        page.get_by_role("button", name="Redo", exact=True).first.click()
        living.settle()
    pose = living.run("", v="lab.session.vertices.tolist()")["v"]
    living.restart(clear=False)
    page.wait_for_function(ASLEEP)
    page.locator(".facelab-lab").first.scroll_into_view_if_needed()
    snapshot(living, "asleep")
    living.run_cells()
    snapshot(living, "offered")
    page.get_by_role("button", name="Back to the pose of").first.click()
    living.settle()
    back = living.run("", v="lab.session.vertices.tolist()", g="list(lab.session.state.gaze)")
    np.testing.assert_allclose(back["v"], pose, atol=1e-9)
    assert back["g"] == [20, 0] and len(living.run("", p="list(lab.session.pins)")["p"]) == 1


def test_a_notebook_that_has_not_run_shows_a_picture_and_no_error(living):
    page = living.page
    stored = living.folder / "life.ipynb"
    # as a stranger gets it: of the course, and not trusted
    shutil.copy(stored, living.folder / "course.ipynb")
    complete(living.folder / "course.ipynb")
    for name in ("life", "course"):
        living.load(f"{name}.ipynb")
        expect(page.locator(".facelab-still img")).to_have_count(2)
        expect(page.locator(".facelab-still img").first).to_be_visible()
        expect(page.get_by_text("model not found").locator("visible=true")).to_have_count(0)
        expect(page.get_by_text("Box(children").locator("visible=true")).to_have_count(0)
        snapshot(living, f"stored_{name}")
