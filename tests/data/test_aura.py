import os
from pathlib import Path

import numpy as np
import pytest

from facelab.data import cache as cache_module
from facelab.data.aura import AURA_LANDMARKS, AURA_UNITS, load_aura, load_aura_take
from facelab.data.cache import DataUnavailable


@pytest.fixture
def folder():
    root = os.environ.get("FACELAB_AURA")
    if not root:
        pytest.skip("FACELAB_AURA is not set: no files of Aura on this machine")
    return Path(root)


@pytest.fixture
def aura(folder):
    return load_aura(folder)


def moves(rig, unit, landmark):
    return rig.deltas[rig.names.index(unit), rig.neutral.landmarks[landmark]]


def test_there_are_72_units_each_with_a_name_of_its_own():
    assert len(set(AURA_UNITS)) == len(AURA_UNITS) == 72


def test_the_head_is_one_piece_open_at_the_neck_alone(aura):
    mesh = aura.neutral
    assert (mesh.n_vertices, len(mesh.faces)) == (5944, 2 * 5924)
    assert len(np.unique(mesh.pieces)) == 1
    (rim,) = mesh.boundary_loops
    assert mesh.vertices[rim, 1].max() < mesh.vertices[mesh.landmarks["chin"], 1]


def test_triangles_in_pairs_are_the_quads(aura, folder):
    with np.load(folder / "aura_compressed.npz") as data:
        quads = data["quads"]
    both = np.sort(aura.neutral.faces.reshape(-1, 6), axis=1)
    for pair, quad in zip(both.tolist(), quads.tolist(), strict=True):
        assert set(pair) == set(quad)


def test_displacements_are_those_of_its_bones(aura, folder):
    with np.load(folder / "aura_compressed.npz") as data:
        rest, weights, S = data["rest"], data["weights"], data["shapeXform"]
    k, v = AURA_UNITS.index("jawDrop"), AURA_LANDMARKS["chin"]
    moved = sum(
        weights[v, b] * (S[3 * k : 3 * k + 3, 4 * b : 4 * b + 4] @ np.append(rest[v], 1))
        for b in range(40)
    )
    np.testing.assert_allclose(aura.deltas[k, v], 10 * moved, atol=1e-3)  # mm; float32


@pytest.mark.parametrize(
    "unit, landmark, axis, sign, mm",
    [
        ("jawDrop", "chin", 1, -1, 10),
        ("jawSidewaysLeft", "chin", 0, 1, 3),
        ("jawThrust", "chin", 2, 1, 3),
        ("lipCornerPuller_L", "mouth_corner_left", 1, 1, 3),
        ("lipCornerPuller_R", "mouth_corner_right", 1, 1, 3),
        ("lipStretcher_L", "mouth_corner_left", 0, 1, 3),
        ("mouthRight", "mouth_corner_left", 0, -1, 3),
    ],
)
def test_units_move_what_their_names_say_on_the_persons_side(aura, unit, landmark, axis, sign, mm):
    assert sign * moves(aura, unit, landmark)[axis] > mm


def test_every_unit_of_a_side_moves_that_side_more(aura):
    x = aura.neutral.vertices[:, 0]
    size = np.linalg.norm(aura.deltas, axis=2)
    for name, d in zip(aura.names, size, strict=True):
        end = name.rpartition("_")[2]
        if end[0] in "LR" and len(end) <= 2:
            left, right = d[x > 1].sum(), d[x < -1].sum()
            assert (left > right) == (end[0] == "L"), name


def test_the_animation_drives_all_of_it(aura, folder):
    take = load_aura_take(folder)
    assert take.n_frames == 2800 and take.names == aura.names and take.fps == 60
    assert take.weights.mean() == pytest.approx(0.034, abs=5e-4)
    below = take.weights < -1e-3
    assert (below.any(axis=0).sum(), (take.weights > 1).sum()) == (3, 0)
    assert take.weights.min() == pytest.approx(-0.064, abs=1e-3)
    assert load_aura_take(folder, fps=30).fps == 30
    with pytest.raises(ValueError, match="fps=0"):
        load_aura_take(folder, fps=0)


def test_a_folder_without_it_or_with_another_file_is_refused(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match=r"root=.* holds no aura_compressed\.npz"):
        load_aura(tmp_path)
    monkeypatch.setenv("FACELAB_AURA", str(tmp_path))
    with pytest.raises(FileNotFoundError, match=r"FACELAB_AURA=.* holds no test_anim\.npz"):
        load_aura_take()
    np.savez(tmp_path / "expected_aura.npz", rest=np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"expected_aura\.npz is not the file it should be"):
        load_aura()


def test_without_a_folder_the_pinned_file_is_asked_for(tmp_path, monkeypatch):
    asked = []

    def retrieve(url, known_hash, **_):
        asked.append((url, known_hash))
        raise ConnectionError

    monkeypatch.delenv("FACELAB_AURA", raising=False)
    monkeypatch.delenv("FACELAB_OFFLINE", raising=False)
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))
    monkeypatch.setattr(cache_module.pooch, "retrieve", retrieve)
    for load in (load_aura, load_aura_take):
        with pytest.raises(DataUnavailable, match="FACELAB_AURA for the head Aura"):
            load()
    (rig, rig_hash), (take, take_hash) = asked
    assert "/8741eed6730fbfc3b762f46ba2c5f4a36807ec1b/" in rig and rig.endswith("expected_aura.npz")
    assert "/22e6f5fa19e533d84916bb1abd9dc88c4ac3054e/in/test_anim.npz" in take
    assert rig_hash.startswith("sha256:78a8e9cb") and take_hash.startswith("sha256:1b1f64cc")
