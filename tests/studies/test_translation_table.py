"""Translation and its peers in one table: planted rigs, means by hand, what the page says."""

from pathlib import Path

import numpy as np
import pytest
from shapes import sphere_mesh

from facelab.data import DataUnavailable
from facelab.motion import WeightSequence
from facelab.rig import BlendshapeRig
from facelab.studies import translation
from facelab.studies import translation_table as study


def bumps(radius, names, order):
    """A rig of three bumps on a sphere, as large as the sphere is, in some order."""
    mesh = sphere_mesh(3, radius=radius)
    rng = np.random.default_rng(3)
    middles = mesh.vertices[rng.choice(mesh.n_vertices, 3, replace=False)]
    away = np.linalg.norm(mesh.vertices - middles[:, None], axis=2) / radius
    deltas = 0.1 * radius * np.exp(-((away / 0.3) ** 2))[..., None] * rng.normal(size=(3, 1, 3))
    return BlendshapeRig(mesh, names, deltas[order])


@pytest.fixture(scope="module")
def crossed():
    """Two heads of the same shapes, of which two have each other's names; one is larger."""
    small = bumps(100.0, ["jawOpen", "jawLeft", "cheekPuff"], [0, 1, 2])
    return small, bumps(120.0, ["jawLeft", "jawOpen", "AU34"], [0, 1, 2])


@pytest.fixture(scope="module")
def take(crossed):
    weights = np.random.default_rng(5).uniform(0, 1, (40, 3))
    return WeightSequence(weights, crossed[0].names, 30)


@pytest.fixture(scope="module")
def rows(crossed, take):
    pair, names = translation.both_ways(*crossed), study.names_of(*crossed)
    return study.errors(dict(rig="A", other="B"), pair, {"one": take}, names, fps=15)


def test_names_that_mean_the_same_in_arkit_find_each_other(crossed):
    same = {n: (n,) for n in ("jawOpen", "jawLeft")}
    assert study.names_of(*crossed) == {**same, "cheekPuff": ("AU34",)}


def test_every_way_has_a_row_with_the_thinned_frames(rows):
    assert [row["way"] for row in rows] == list(study.WAYS)
    assert {row["frames"] for row in rows} == {20}


def test_shapes_find_what_names_get_wrong(rows, crossed, take):
    named, nearest, transfer, ours = rows
    a = take.resampled(15).weights
    b = a[:, [1, 0, 2]]  # what names make of it
    # the larger head moves 1.2 times as far; the measure is taken on one of both faces
    d = crossed[0].deltas
    missed = np.tensordot(b - a, d, axes=1)
    share = np.sqrt((missed**2).sum() / (np.tensordot(a, d, axes=1) ** 2).sum())
    assert named["left_mm"] / named["moves_mm"] == pytest.approx(share, abs=0.01) and share > 0.3
    assert named["lost"] == 0 and named["weights_off"] == 0  # crossed twice
    for row in (nearest, transfer):
        assert row["left_mm"] < 0.01 * row["moves_mm"], row
        assert row["lost"] < 0.01 and row["weights_off"] < 0.01, row
    assert ours["left_mm"] < 0.05 * ours["moves_mm"] and ours["weights_off"] < 0.1


def test_deformation_transfer_reads_each_frame_on_the_other_face(crossed, take):
    for rig, other in (crossed, crossed[::-1]):
        pair = translation.Translator(rig, other)
        peer = translation.FrameTransfer(pair)
        to = peer.translate(WeightSequence(take.weights, rig.names, 30))
        assert to.names == other.names
        np.testing.assert_allclose(to.weights, take.weights, atol=2e-3)


def test_lost_frames_stay_lost_by_deformation_transfer(crossed, take):
    valid = np.arange(take.n_frames) != 1
    weights = np.where(valid[:, None], take.weights, np.nan)
    lost = WeightSequence(weights, take.names, 30, valid)
    to = translation.FrameTransfer(translation.Translator(*crossed)).translate(lost[:3])
    assert to.valid.tolist() == [True, False, True]
    assert np.isnan(to.weights[1]).all() and np.isfinite(to.weights[[0, 2]]).all()


def made(other, way, left, lost=0.1, take="one"):
    return dict(
        **dict(rig="face", other=other, take=take, way=way, frames=9, moves_mm=4.0, left_mm=left),
        **dict(lost=lost, weights_off=0.25, active=3.0, per_second=50.0),
    )


def test_lines_are_means_over_takes_and_actors():
    rows = [
        *(made("Aura", "names", mm, take=t) for mm, t in ((2.0, "one"), (4.0, "two"))),
        *(made("Aura", "map", mm, x, t) for mm, x, t in ((1.0, 0.1, "one"), (2.0, 0.2, "two"))),
        *(made(f"actor {n}", "names", mm) for n, mm in (("M1", 1.0), ("F1", 3.0))),
        *(made(f"actor {n}", "map", mm) for n, mm in (("M1", 1.0), ("F1", 2.0))),
    ]
    aura, ours, actors, theirs = study.summed(rows)
    assert aura[:5] == ["face to Aura", "by names", 4.0, 3.0, None]
    assert ours[3:6] == [1.5, "50 %", "15 %"]
    assert actors[0] == "face to synthetic actors" and actors[3] == 2.0
    assert theirs[1:] == ["translate", 4.0, 1.5, "25 %", "10 %", 0.25, "3", "50"]


@pytest.fixture
def planted(monkeypatch, crossed, take):
    def gone():
        raise DataUnavailable("no Aura here")

    monkeypatch.setattr(study.data, "load_ict_facekit", lambda: crossed[0])
    monkeypatch.setattr(study.data, "load_aura", gone)
    monkeypatch.setattr(study.data, "load_take", lambda name: take[:6])

    class Capture:
        class rig:
            linear = staticmethod(lambda: crossed[1])

    monkeypatch.setattr(study.data, "load_capture", lambda *_: Capture)


def test_the_command_writes_rows_and_page_and_says_what_is_missing(planted, tmp_path, capsys):
    study.main(["--out", str(tmp_path)])
    n = len(study.data.ACTORS) * len(study.data.TAKES) * len(study.WAYS)
    assert f"{n} trips" in capsys.readouterr().out
    text = (tmp_path / "translation.md").read_text(encoding="utf-8")
    assert "| generic face to synthetic actors | translate |" in text
    assert "left out: Aura." in text and "Aura to" not in text
    assert len((tmp_path / "translation.csv").read_text().splitlines()) == n + 1


def test_without_any_pair_nothing_is_written(planted, monkeypatch, tmp_path):
    monkeypatch.setattr(study.data, "load_ict_facekit", study.data.load_aura)
    with pytest.raises(SystemExit, match="the generic face, Aura"):
        study.main(["--out", str(tmp_path)])
    assert not list(tmp_path.iterdir())


def test_on_the_stored_page_translate_is_nearer_than_names_and_loses_less():
    page = Path(__file__).resolve().parents[2] / "docs/translation.md"
    lines = page.read_text(encoding="utf-8").splitlines()
    cells = [line.strip("| ").split(" | ") for line in lines if line.startswith("| ")][2:]
    pairs = list(dict.fromkeys(row[0] for row in cells))
    assert len(cells) == len(pairs) * len(study.WAYS) and len(pairs) == 3
    for pair in pairs:
        by = {row[1]: row for row in cells if row[0] == pair}
        named, ours = by["by names"], by["translate"]
        assert float(ours[3]) < float(named[3]), pair
        losses = [float(row[5].removesuffix(" %")) for row in by.values()]
        assert float(ours[5].removesuffix(" %")) == min(losses), pair
