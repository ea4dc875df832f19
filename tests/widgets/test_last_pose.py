"""The pose of last time: kept when the page made it, and offered when the lab opens anew."""

import numpy as np
import pytest
from planted import bumps, quarters

from facelab.models.region import RegionModel
from facelab.posing.session import PosingSession
from facelab.segmentation.regions import Regions
from facelab.widgets import PosingLab, last_pose


@pytest.fixture
def page(monkeypatch):
    """What the lab takes for whether a page asks."""
    asks = [True]
    monkeypatch.setattr(last_pose, "asked_by_page", lambda: asks[-1])
    return asks


@pytest.fixture
def opened(rng, tmp_path):
    mesh, labels = quarters()
    model = RegionModel(Regions(labels, mesh), 6).fit(bumps(mesh, labels, rng))
    return lambda: PosingLab(PosingSession(model, mesh), folder=tmp_path)


def pull(lab, by):
    lab.session.pull(17, lab.mesh.vertices[17] + [0, by, 0])
    return lab.session.vertices


def test_a_lab_that_opens_anew_offers_the_last_pose_of_the_page(page, opened):
    first = opened()
    assert first.last.widgets == []  # nothing to go back to
    pose = pull(first, 3.0)
    second = opened()
    (button,) = second.last.widgets
    pull(second, -1.0)  # does not lose what was found
    button.click()
    np.testing.assert_array_equal(second.session.vertices, pose)
    assert second.session.n_undo == 2 and list(second.session.pins) == [17]
    second.session.undo()
    assert opened().last.state.pins[17][1] == pytest.approx(-1)


def test_each_face_and_each_model_has_its_own(page, rng, tmp_path):
    mesh, labels = quarters()
    moved = mesh.with_vertices(mesh.vertices * [1.0, 1.1, 1.0])
    X = bumps(mesh, labels, rng)

    def opened(face, n):
        model = RegionModel(Regions(labels, face), n).fit(X)
        return PosingLab(PosingSession(model, face), folder=tmp_path)

    kinds = [(mesh, 6), (moved, 6), (mesh, 5)]
    for by, kind in enumerate(kinds, 1):
        lab = opened(*kind)
        assert lab.last.widgets == []
        pull(lab, by)
    for by, kind in enumerate(kinds, 1):
        assert opened(*kind).last.state.pins[17][1] == pytest.approx(by)


def test_what_a_script_does_is_not_kept_nor_what_cannot_be_read_offered(page, opened):
    page.append(False)
    lab = opened()
    pull(lab, 3.0)
    assert not lab.last.path.exists() and opened().last.widgets == []
    lab.last.path.write_text('{"no": "library"}')
    assert opened().last.widgets == []


def test_a_folder_that_cannot_be_written_to_does_not_stop_the_posing(page, opened):
    lab = opened()
    lab.last.path = lab.last.path / "not" / "there.last.json"
    pose = pull(lab, 3.0)
    assert np.abs(pose - lab.mesh.vertices).max() > 1
    assert "will not come back by itself" in lab._status.value
