"""Landmarks set by clicks, on a face that grows with the page and fills the screen."""

import numpy as np
import pytest
from browser_lab import Lab, snapshot, wait_until, write_notebook
from test_posing_lab import on_page

CELL = """
import facelab
from facelab.widgets import LandmarkPicker
known = facelab.load_template()
bare = facelab.TriangleMesh(known.vertices, known.faces)
lab = LandmarkPicker(bare)
lab"""


@pytest.fixture(scope="module")
def picker(server):
    lab = Lab(server)
    try:
        lab.open(write_notebook(lab.folder / "source" / "picker.ipynb", [CELL]))
        lab.bring_into_view()
        yield lab
    finally:
        lab.close()


def test_six_clicks_set_six_landmarks_that_undo_takes_back_and_save_writes(picker):
    page = picker.page
    names = picker.run("", n="list(lab.names)")["n"]
    truth = np.array(
        picker.run("", t="[known.vertices[known.landmarks[n]].tolist() for n in lab.names]")["t"]
    )
    for name, spot in zip(names, on_page(picker, truth), strict=True):
        page.mouse.click(*spot)
        wait_until(picker, f"{name!r} in lab.landmarks")
    found = picker.run("", f="[known.vertices[lab.landmarks[n]].tolist() for n in lab.names]")["f"]
    assert np.linalg.norm(np.array(found) - truth, axis=1).max() < 2.5
    picker.settle()
    snapshot(picker, "picker")
    side = page.locator(".facelab-side")
    assert "they agree with a face" in side.inner_text()
    page.get_by_role("button", name="Undo").click()
    wait_until(picker, "len(lab.landmarks) == 5")
    page.get_by_role("button", name="Save", exact=True).click()
    side.get_by_role("link").wait_for()
    assert (picker.folder / "landmarks.ljson").exists()


def test_its_face_grows_with_the_page_and_fills_the_screen(picker):
    page, widths = picker.page, []
    for width in (900, 1400):
        page.set_viewport_size({"width": width, "height": 1000})
        snapshot(picker, f"picker_{width}")
        widths.append(picker.bring_into_view()["width"])
    assert widths[0] < widths[1] <= 1.6 * 470
    page.get_by_label("Full screen").first.click()
    page.wait_for_function("document.fullscreenElement !== null")
    picker.settle()
    box = page.locator("canvas").first.bounding_box()
    assert (box["width"], box["height"]) == (1400, 1000)
    page.get_by_label("Full screen").first.click()
    page.wait_for_function("document.fullscreenElement === null")
    assert picker.bring_into_view()["height"] < 900
