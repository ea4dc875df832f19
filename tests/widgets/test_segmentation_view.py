"""The live segmentation without a browser: set a slider, read the colours of the face."""

import warnings

import numpy as np
import pytest
from planted import patch_motion, quarters
from shapes import grid_mesh
from shown import shown

from facelab.plotting import region_colors
from facelab.segmentation.regions import Regions
from facelab.segmentation.segment import Affinity
from facelab.widgets.segmentation_view import SegmentationView


@pytest.fixture
def affinity(rng):
    mesh, truth = quarters()
    return Affinity.of(patch_motion(mesh, truth, rng, noise=0.6))


def colors_of(view):
    return view.view._color.array[: view.view.mesh.n_vertices]


def assert_painted(view, labels):
    """One colour for each region, all different."""
    colors = colors_of(view)
    for i in range(labels.max() + 1):
        assert len(np.unique(colors[labels == i], axis=0)) == 1
    assert len(np.unique(colors, axis=0)) == labels.max() + 1


@pytest.mark.parametrize(
    ("control", "value"), [("lam", 0.0), ("r", 4.0), ("threshold", 0.95), ("n_regions", 7)]
)
def test_a_slider_cuts_anew_as_segment_does_and_back_again(affinity, control, value):
    view = SegmentationView(affinity, n_regions=5)
    first = view.regions.labels
    assert_painted(view, first)
    start = getattr(view, control).value
    getattr(view, control).value = value
    settings = {"n_regions": 5}
    other = affinity
    if control == "n_regions":
        settings["n_regions"] = value
    else:
        other = affinity.with_(**{control: value})
    expected = other.segment(**settings, random_state=0, progress=False)
    np.testing.assert_array_equal(view.regions.labels, expected.labels)
    assert not np.array_equal(expected.labels, first), "the example should show a change"
    assert_painted(view, expected.labels)
    getattr(view, control).value = start
    np.testing.assert_array_equal(view.regions.labels, first)


def test_growing_takes_as_many_as_stay_compact_and_says_why(affinity):
    view = SegmentationView(affinity.with_(lam=1.0, threshold=0.8), n_regions=3)
    view.grow.value = True
    grown = view.affinity.segment(random_state=0, progress=False)
    np.testing.assert_array_equal(view.regions.labels, grown.labels)
    assert "then no more" in view._status.value
    assert view.n_regions.disabled
    view.grow.value = False
    assert view.regions.n_regions == 3 and not view.n_regions.disabled


def test_growth_to_the_end_of_the_slider_is_told_in_the_page_and_not_warned_of(rng):
    mesh, truth = quarters()
    view = SegmentationView(Affinity.of(patch_motion(mesh, truth, rng)), n_regions=2)
    view.n_regions.max = 3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        view.grow.value = True
    assert view._message.value == ""
    assert view.regions.n_regions == 3
    assert "the most allowed" in view._status.value


def test_regions_keep_their_colours_when_a_slider_moves(affinity):
    view = SegmentationView(affinity, n_regions=4)
    labels = view.regions.labels
    view._colors = before = view._colors[::-1]  # as after a long history: not what comes first
    view.n_regions.value = 5  # one patch is cut in two, the others are as they were
    after = view.regions.labels
    whole = [i for i in range(4) if len(set(after[labels == i])) == 1]
    assert len(whole) == 3
    same = np.isin(labels, whole)
    np.testing.assert_allclose(colors_of(view)[same], before[labels[same]], atol=1e-6)


def test_a_dense_face_shows_the_region_of_the_nearest_sample(rng):
    coarse, truth = quarters(6, 5, 9.0)
    dense = grid_mesh(16, 13, 3.0)
    row, column = np.divmod(np.arange(30), 6)
    samples = 3 * row * 16 + 3 * column
    affinity = Affinity.of(patch_motion(coarse, truth, rng))
    view = SegmentationView(affinity, dense, samples, n_regions=4)
    assert_painted(view, view.regions.labels[dense.nearest_of(samples)])


def test_an_error_is_shown_in_the_page_the_last_cut_stays_and_the_error_goes_away(
    affinity, monkeypatch
):
    view = SegmentationView(affinity, n_regions=4)
    before, colors = view.regions, colors_of(view).copy()

    def broken(*_, **__):
        raise RuntimeError("no <regions> left")

    monkeypatch.setattr(Affinity, "segment", broken)
    view.lam.value = 0.2
    assert "no &lt;regions&gt; left" in view._message.value
    assert view.regions is before
    np.testing.assert_array_equal(colors_of(view), colors)
    monkeypatch.undo()
    view.lam.value = 0.3
    assert view._message.value == ""
    assert view.regions is not before


def test_it_refuses_what_it_cannot_show(affinity):
    with pytest.raises(TypeError, match="affinity is a ndarray"):
        SegmentationView(affinity.C_bar)
    with pytest.raises(ValueError, match="face and samples belong together"):
        SegmentationView(affinity, face=affinity.mesh)


def test_colours_of_another_cut_are_kept_where_regions_overlap():
    mesh, labels = quarters()
    first = Regions(labels, mesh)
    colors = region_colors(first)
    renamed = np.array([2, 0, 3, 1])[labels]
    again = region_colors(Regions(renamed, mesh), like=(first, colors))
    np.testing.assert_array_equal(again[renamed], colors[labels])
    split = labels.copy()
    split[np.flatnonzero(labels == 0)[:8]] = 4
    more = region_colors(Regions(split, mesh), like=(first, colors))
    np.testing.assert_array_equal(more[:4], colors)
    assert np.linalg.norm(more[4] - colors, axis=1).min() > 0.1


def test_where_it_does_not_run_a_notebook_has_the_face_in_the_colours_of_its_regions(
    affinity, monkeypatch
):
    view = SegmentationView(affinity, n_regions=4)
    still, image, _ = shown(view, monkeypatch)
    assert "λ 0.70, r 10 mm, threshold 0.70: 4 regions." in still
    hues = image / image.max(axis=2, keepdims=True)
    for color in region_colors(view.regions):  # lit, so darker, but of the same hue
        assert np.isclose(hues, color / color.max(), atol=0.03).all(axis=2).mean() > 0.05
    view.n_regions.value = 7
    more, other, _ = shown(view, monkeypatch)
    assert "7 regions." in more and not np.array_equal(image, other)
