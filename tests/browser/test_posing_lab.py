"""The lab as a person uses it: a mouse on a canvas in JupyterLab, checked by the vertices."""

import os
import time
from pathlib import Path

import numpy as np
import pytest

LANDMARKS = ("mouth_corner_left", "mouth_corner_right", "brow_left_3", "nose_tip")


@pytest.fixture
def fresh(posing_lab):
    """The lab with the neutral face, no pins, the region model and the values of the paper."""
    posing_lab.run(
        "session = lab.session\n"
        "session.use(region); session.reset(); session.set(beta=0.5, gamma=0.025)\n"
        "lab.refresh()"
    )
    posing_lab.settle()
    return posing_lab


def vertices(lab):
    return np.array(lab.run("", v="lab.session.vertices.tolist()")["v"])


def landmark(lab, name):
    return lab.run("", v=f"rig.neutral.landmarks[{name!r}]")["v"]


def on_page(lab, points):
    """Where points of the face, shape (n, 3), are on the page, pixels."""
    points = np.atleast_2d(points).tolist()
    at = np.array(lab.run("", p=f"lab.view.project(np.array({points})).tolist()")["p"])
    box = lab.page.locator(".jp-OutputArea canvas").first.bounding_box()
    return [(box["x"] + x * box["width"], box["y"] + y * box["height"]) for x, y in at]


def wait_until(lab, condition, seconds=20):
    """Wait for a condition in the kernel: a busy machine hears of the mouse late."""
    end = time.time() + seconds
    while not lab.run("", c=f"bool({condition})")["c"]:
        assert time.time() < end, f"{condition} did not come true in {seconds} s"
        lab.page.wait_for_timeout(100)


def hover(lab, spot):
    """Move the mouse to a spot of the face, and wait until the lab has seen it there."""
    lab.page.mouse.move(spot[0] + 6, spot[1] + 3)
    lab.page.wait_for_timeout(250)
    lab.page.mouse.move(*spot)
    wait_until(lab, "lab.view._hover.visible and not lab.view._orbit.enableRotate")
    lab.settle()


def pull(lab, name, offset, steps=12, release=True):
    """Hover over a landmark, press, move by an offset in millimetres, let go."""
    V = vertices(lab)
    start = V[lab.run("", h=f"lab.session.handle(rig.neutral.landmarks[{name!r}])")["h"]]
    path = start + np.linspace(0, 1, steps + 1)[:, None] * np.asarray(offset, dtype=float)
    at = on_page(lab, path)
    mouse = lab.page.mouse
    hover(lab, at[0])
    mouse.down()
    wait_until(lab, "lab.view._dragging")
    lab.settle()
    for point in at[1:]:
        mouse.move(*point)
        lab.page.wait_for_timeout(30)
    lab.settle()
    if release:
        mouse.up()
        wait_until(lab, "not lab.view._dragging")
        lab.settle()


def snapshot(lab, name):
    """Save a picture of the lab where FACELAB_PICTURES names a folder."""
    if os.environ.get("FACELAB_PICTURES"):
        page = lab.page.locator(".jp-OutputArea-output:has(canvas)").first
        page.screenshot(path=str(Path(os.environ["FACELAB_PICTURES"]) / f"{name}.png"))


def test_an_untouched_lab_has_the_values_of_the_paper_and_nothing_to_undo(posing_lab):
    state = posing_lab.run("", s="[lab.session.beta, lab.session.gamma, lab.session.can_undo]")
    assert state["s"] == [0.5, 0.025, False]


def test_pulling_a_mouth_corner_by_8_mm_smirks_on_that_side_and_leaves_the_eyes(fresh):
    before, picture = vertices(fresh), fresh.page.locator("canvas").first.screenshot()
    pull(fresh, "mouth_corner_left", 8 * np.array([0.5, np.sqrt(0.75), 0]))
    snapshot(fresh, "smirk")
    moved = np.linalg.norm(vertices(fresh) - before, axis=1)
    lids = fresh.run("", v="[v for n, v in rig.neutral.landmarks.items() if n.startswith('eye_')]")[
        "v"
    ]
    assert moved[landmark(fresh, "mouth_corner_left")] >= 5
    assert moved[landmark(fresh, "mouth_corner_right")] < 2
    assert moved[lids].max() <= 0.5
    assert fresh.page.locator("canvas").first.screenshot() != picture, "the page shows no change"
    assert fresh.page.get_by_text("mouth corner left:").is_visible()


def test_pressing_without_moving_changes_nothing_and_twenty_presses_do_not_drift(fresh):
    pull(fresh, "mouth_corner_left", [2, 4, 0])
    before = vertices(fresh)
    (spot,) = on_page(fresh, before[landmark(fresh, "brow_left_3")])
    hover(fresh, spot)
    fresh.run(
        "noticed = 0\n"
        "def count(vertex, press=lab._press):\n"
        "    global noticed\n    noticed += 1\n    press(vertex)\n"
        "lab.view.on_press = count"
    )
    for k in range(20):  # a kernel far behind the mouse would see two clicks as one: wait for it
        fresh.page.mouse.down()
        wait_until(fresh, f"noticed == {k + 1} and lab.view._dragging")
        fresh.page.mouse.up()
        wait_until(fresh, "not lab.view._dragging")
        fresh.settle()
    assert fresh.run("", n="len(lab.session.pins)")["n"] == 1, "a click should set no pin"
    assert np.abs(vertices(fresh) - before).max() < 0.05


def test_undo_and_redo_return_exactly(fresh):
    before = vertices(fresh)
    pull(fresh, "mouth_corner_left", [2, 5, 0])
    after = vertices(fresh)
    fresh.page.get_by_role("button", name="Undo").click()
    fresh.settle()
    np.testing.assert_array_equal(vertices(fresh), before)
    fresh.page.get_by_role("button", name="Redo").click()
    fresh.settle()
    np.testing.assert_array_equal(vertices(fresh), after)


def test_the_holistic_model_answers_the_same_pins_with_the_whole_face(fresh):
    neutral = vertices(fresh)
    pull(fresh, "mouth_corner_left", [3, 6, 0])
    far = np.linalg.norm(neutral - neutral[landmark(fresh, "mouth_corner_left")], axis=1) > 40
    regional = np.linalg.norm(vertices(fresh) - neutral, axis=1)
    pins = fresh.run("", p="[t.tolist() for t in lab.session.pins.values()]")["p"]
    fresh.page.get_by_role("button", name="holistic").click()
    fresh.settle()
    snapshot(fresh, "holistic")
    holistic = np.linalg.norm(vertices(fresh) - neutral, axis=1)
    assert fresh.run("", p="[t.tolist() for t in lab.session.pins.values()]")["p"] == pins
    assert (holistic[far] ** 2).sum() > 2 * (regional[far] ** 2).sum()


def test_a_pin_can_be_removed_from_the_list(fresh):
    before = vertices(fresh)
    pull(fresh, "mouth_corner_left", [2, 5, 0])
    fresh.page.locator("button[title='Remove this pin']").first.click()
    fresh.settle()
    np.testing.assert_allclose(vertices(fresh), before, atol=1e-12)


def test_a_slider_changes_the_answer_to_the_same_pin(fresh):
    pull(fresh, "mouth_corner_left", [2, 6, 0])
    before = vertices(fresh)
    fresh.run("lab.gamma.value = 1.0")
    fresh.settle()
    corner = landmark(fresh, "mouth_corner_left")
    rest = fresh.run("", v=f"rig.neutral.vertices[{corner}].tolist()")["v"]
    far, near = (np.linalg.norm(V[corner] - rest) for V in (before, vertices(fresh)))
    assert near < 0.7 * far, "a larger gamma should hold the face back"


def test_dragging_beside_the_face_turns_it_and_a_drag_then_moves_in_the_view_plane(fresh):
    before = vertices(fresh)
    box = fresh.page.locator(".jp-OutputArea canvas").first.bounding_box()
    x, y = box["x"] + 30, box["y"] + box["height"] - 40
    fresh.page.mouse.move(x, y)
    fresh.settle()
    fresh.page.mouse.down()
    for step in range(10):
        fresh.page.mouse.move(x + 12 * step, y)
    fresh.page.mouse.up()
    fresh.settle()
    eye = fresh.run("", e="list(lab.view._camera.position)")["e"]
    assert abs(eye[0]) > 50, "the camera should have gone round"
    np.testing.assert_array_equal(vertices(fresh), before)
    ahead = np.array(eye) - fresh.run("", t="lab.view._target.tolist()")["t"]
    ahead /= np.linalg.norm(ahead)
    across = np.cross([0, 1, 0], ahead)
    pull(fresh, "nose_tip", 3 * across / np.linalg.norm(across))
    start, target = fresh.run(
        "",
        p="[[rig.neutral.vertices[v].tolist(), t.tolist()] for v, t in lab.session.pins.items()]",
    )["p"][0]
    went = np.array(target) - start
    assert np.linalg.norm(went) == pytest.approx(3, abs=0.5)
    assert abs(went @ ahead) < 0.1, "the drag left the view plane"


def test_an_error_in_a_callback_is_shown_in_the_page_and_the_pose_stays(fresh):
    before = vertices(fresh)
    fresh.run("def boom(*_):\n    raise ValueError('a planted mishap')\nlab.session.drag = boom")
    pull(fresh, "mouth_corner_left", [2, 4, 0])
    assert fresh.page.get_by_text("a planted mishap").is_visible()
    np.testing.assert_array_equal(vertices(fresh), before)
    fresh.run("del lab.session.drag")
    pull(fresh, "mouth_corner_left", [2, 4, 0])
    assert not fresh.page.get_by_text("a planted mishap").is_visible()
    assert np.abs(vertices(fresh) - before).max() > 1
