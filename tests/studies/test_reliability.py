import numpy as np
import pytest

import facelab
from facelab.registration.confidence import free_edges
from facelab.studies.reliability import (
    Reliability,
    reliability,
    skin_parts,
    spread_markers,
    table,
)


def test_shares_are_counted_and_bins_hold_what_was_planted(rng):
    said = rng.uniform(0, 3, size=20_000)
    found = said * np.abs(rng.normal(size=said.shape)) / 1.645  # nine in ten stay below
    r = Reliability(said, found)
    count, rms, share = r.curve([0.0, 1, 2, 3, 4])
    assert count.sum() == len(said) and count[3] == 0
    np.testing.assert_allclose(share[:3], 0.9, atol=0.015)  # 5 sigma of 6,700
    assert np.isnan(share[3]) and np.isnan(rms[3]) and (np.diff(rms[:3]) > 0).all()
    low = r.said <= 1
    assert r.share_within(1.0) == (r.found[low] <= 1).mean() and r.share_said(1.0) == low.mean()
    assert np.isnan(r.share_within(-1))


def test_joined_is_as_if_counted_at_once():
    a, b = Reliability(np.array([0.1, 2]), np.array([0.2, 1])), Reliability(np.ones(1), np.ones(1))
    both = Reliability.joined([a, b])
    assert both.said.tolist() == [0.1, 2, 1] and both.found.tolist() == [0.2, 1, 1]


def test_few_markers_lie_far_apart_and_a_fit_can_start_from_them(rng):
    P = rng.uniform(0, 100, size=(150, 3))
    P[3] = np.nan
    names = [f"m{i}" for i in range(150)]
    chosen = spread_markers(P, names, set(names[:30]), 40)
    assert len(set(chosen)) == 40 and 3 not in chosen
    assert sum(i < 30 for i in chosen) >= 12

    def nearest(some):
        apart = np.linalg.norm(P[some][:, None] - P[some], axis=2)
        return np.min(apart + 1e9 * np.eye(len(some)))

    random = rng.permutation(np.delete(np.arange(150), 3))[:40]
    assert nearest(chosen) > 2 * nearest(random)
    assert len(spread_markers(P, names, set(), 500)) == 149


def test_lids_and_lips_are_parts_of_their_own_also_where_the_mesh_is_closed():
    face = facelab.load_template(4375)
    parts = skin_parts(face)
    assert (sum(mask.astype(int) for mask in parts.values()) == 1).all()
    assert parts["lids"][face.landmarks["eye_left_upper_inner"]]
    assert parts["lips"][face.landmarks["mouth_inner_lower"]]
    assert parts["face"][face.landmarks["nose_tip"]]
    marks = {n: v for n, v in face.landmarks.items() if not n.startswith(("eye", "mouth"))}
    bare = skin_parts(facelab.TriangleMesh(face.vertices, face.faces, marks))
    assert bare["face"].all()
    closed = [n for n in face.landmarks if n.startswith("eye")]
    without = facelab.TriangleMesh(
        face.vertices, np.vstack([face.faces, *map(_fan, face.boundary_loops[1:])]), face.landmarks
    )
    lids, _ = free_edges(without)
    assert set(lids) == {face.landmarks[n] for n in closed}


def _fan(loop):
    """Triangles that close a loop."""
    return np.stack([loop[1:-1], np.full(len(loop) - 2, loop[0]), loop[2:]], axis=1)


@pytest.mark.parametrize("n_markers", [None, 80])
@pytest.mark.parametrize("actor", ["M1", "F2"])
def test_of_the_vertices_said_to_be_within_a_limit_nine_in_ten_are(actor, n_markers):
    found = reliability(actor, ["rage_1"], n_markers)
    for part, r in found.items():
        for limit in (0.5, 1.0, 2.0):
            if r.share_said(limit) > 0.1:  # of one take; fewer vertices move as one
                assert r.share_within(limit) >= (0.9 if part == "face" else 0.85)
    face, lids, lips = (found[part] for part in ("face", "lids", "lips"))
    assert face.share_said(1.0) > 0.5 and lips.share_said(2.0) > 0.3  # and it says something
    assert lids.share_said(0.5) == 0  # a lid is never trusted to half a millimetre
    text = table({actor: found})
    assert "none said so" in text and text.count(actor) == 3
