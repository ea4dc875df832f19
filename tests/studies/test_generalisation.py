import csv
from types import SimpleNamespace

import numpy as np
import pytest
from planted import bumps, quarters

from facelab.models.evaluation import rms_error
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.motion import MotionSequence, WeightSequence
from facelab.rig import BlendshapeRig
from facelab.segmentation.regions import Regions
from facelab.studies import generalisation as results

SIZES = {"EACH": (1, 3), "TOTAL": (4, 8), "SPARSE": (3,), "HOLISTIC": (1, 3, 8)}


class Rig:
    """Five one-sided units and two landmarks on a grid that is symmetric about x = 0."""

    names = results.ONE_SIDED

    def __init__(self, mesh):
        self.neutral = mesh
        rise = np.exp(-((mesh.vertices[:, 0] - 25) ** 2) / 60)
        self.deltas = np.array([np.outer(rise, d) for d in np.eye(5)[:, :3] + 0.3])

    def animate(self, W, vertices):
        return (self.neutral.vertices + np.tensordot(W, self.deltas, axes=1))[:, vertices]


class Actor:
    """What `results` asks of a RegisteredActor, with four takes of planted motion."""

    def __init__(self, name, seed):
        self.takes = {"train": ("a", "b"), "test": ("c", "d")}
        mesh, labels = quarters(9, 6, 10.0)
        mesh = mesh.with_vertices(mesh.vertices - [40, 0, 0])
        landmarks = dict.fromkeys(results.PULLS, 16)
        self.name, self.mesh, self.samples = name, mesh, np.arange(mesh.n_vertices)
        self.template = type(mesh)(mesh.vertices, mesh.faces, landmarks)
        self.regions = Regions(labels, mesh)
        self.capture = SimpleNamespace(rig=Rig(mesh), neutral=mesh)
        rng = np.random.default_rng(seed)
        self.still = {take: bumps(mesh, labels, rng, 20 + i) for i, take in enumerate("abcd")}
        self.noise = {t: 0.1 * rng.normal(size=x.shape) for t, x in self.still.items()}

    def _sequence(self, takes, noise):
        some = self.takes.get(takes, (takes,))
        X = np.concatenate([self.still[t] + noise * self.noise[t] for t in some])
        return MotionSequence(self.mesh.vertices + X.reshape(len(X), -1, 3), 15, self.mesh)

    def motion(self, takes=None):
        return self._sequence(takes, 1)

    def truth(self, takes=None):
        return self._sequence(takes, 0)


@pytest.fixture
def actors(tmp_path, monkeypatch):
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))
    for name, sizes in SIZES.items():
        monkeypatch.setattr(results, name, sizes)
    # the sparse modes are tested beside their function, and take seconds
    monkeypatch.setattr(results, "sparse_model", lambda X, n: HolisticModel(n).fit(X))
    return {name: Actor(name, seed) for seed, name in enumerate(("M1", "F1"))}


@pytest.fixture
def curves(actors):
    return results.synthetic(actors, actors["M1"].regions, progress=False)


def test_every_training_set_meets_every_family_and_target(curves):
    families = {"holistic", "region beta=0", "region beta=0.5", "region total", "sparse"}
    assert set(curves) == {
        (training, family, target)
        for training in ("M1", "M1+F1")
        for family in families
        for target in ("frames", "truth")
    }


def test_a_number_of_the_curves_is_that_of_the_experiment_done_by_hand(actors, curves):
    X = np.concatenate([a.motion("train").displacements() for a in actors.values()])
    T, truth = (getattr(actors["F1"], k)("test").displacements() for k in ("motion", "truth"))
    for family, model in (
        ("holistic", HolisticModel(3)),
        ("region beta=0", RegionModel(actors["M1"].regions, 3, 0.0)),
        ("region beta=0.5", RegionModel(actors["M1"].regions, 3, 0.5)),
    ):
        X_hat = model.fit(X).reconstruct(T)
        for target, wanted in (("frames", T), ("truth", truth)):
            curve = curves["M1+F1", family, target]
            part = curve.of(np.char.startswith(curve.takes, "F1/"))
            assert part.rms[1] == pytest.approx(rms_error(wanted, X_hat), rel=1e-6)
            assert set(part.takes) == {"F1/c", "F1/d"}


def test_results_are_kept_and_found_again_until_data_or_regions_change(
    actors, curves, monkeypatch, tmp_path
):
    (kept,) = (tmp_path / "results").glob("*/arrays.npz")

    def refuse(*_):
        raise AssertionError("computed anew")

    monkeypatch.setattr(results, "compare", refuse)
    again = results.synthetic(actors, actors["M1"].regions, progress=False)
    assert again.keys() == curves.keys()
    for key, curve in curves.items():
        np.testing.assert_array_equal(again[key].rms, curve.rms)
        np.testing.assert_array_equal(again[key].takes, curve.takes)
    other = Regions(actors["M1"].regions.labels[::-1].copy(), actors["M1"].mesh)
    with pytest.raises(AssertionError, match="computed anew"):
        results.synthetic(actors, other, progress=False)
    kept.write_bytes(kept.read_bytes()[:100])  # cut short: not trusted
    with pytest.raises(AssertionError, match="computed anew"):
        results.synthetic(actors, actors["M1"].regions, progress=False)


def test_the_table_has_a_row_for_each_error_with_the_name_of_the_data(actors, curves, tmp_path):
    rows = results.table(curves, "planted", ("M1", "F1"))
    n_models = 2 * (3 + 2 + 2 + 2 + 1)  # two training sets
    assert len(rows) == n_models * 2 * 2  # two targets, two people
    results.write_csv(tmp_path / "errors.csv", rows)
    with open(tmp_path / "errors.csv", newline="") as stored:
        found = list(csv.DictReader(stored))
    assert len(found) == len(rows)
    assert {row["data"] for row in found} == {"planted"}
    for row in found[:5]:
        assert float(row["low_mm"]) <= float(row["rms_mm"]) <= float(row["high_mm"])


def test_symmetric_training_leaves_regions_able_to_make_one_side(actors):
    actor = actors["M1"]
    rows = results.asymmetry(actor, actor.regions, n_components=3, template=actor.template)
    assert len(rows) == 2 * 3 * (5 + 2)
    side = {(r["training"], r["model"], r["expression"]): r["other_side"] for r in rows}
    for expression in results.ONE_SIDED[:3]:
        whole = side["symmetrised", "holistic", expression]
        assert whole == pytest.approx(0.5, abs=1e-6)
        assert side["symmetrised", "region beta=0", expression] < 0.1
    assert all((r["error_mm"] is None) == r["expression"].startswith("pull") for r in rows)


def test_the_command_writes_both_tables_and_says_what_is_missing(
    actors, monkeypatch, tmp_path, capsys
):
    def absent():
        raise results.data.DataUnavailable("no scanned face here")

    monkeypatch.setattr(results, "load_actors", lambda: actors)
    monkeypatch.setattr(results, "face_regions", lambda actor: actor.regions)
    monkeypatch.setattr(results, "ACTORS", ("M1", "F1"))
    monkeypatch.setattr(results, "real", absent)
    monkeypatch.setattr(results.data, "load_template", lambda n: actors["M1"].template)
    results.main(["--out", str(tmp_path / "tables")])
    assert "no scanned face here" in capsys.readouterr().out
    for name in ("generalisation", "asymmetry"):
        text = (tmp_path / "tables" / f"{name}.csv").read_text()
        assert text.startswith("data,training")
        assert "synthetic actor" in text


def test_the_recorded_face_learns_from_one_take_with_noise_and_is_tested_on_the_other(
    monkeypatch, tmp_path, rng
):
    mesh, _ = quarters(21, 20, 8.0)
    rig = BlendshapeRig(mesh, ["a", "b"], rng.normal(size=(2, mesh.n_vertices, 3)))
    takes = {
        name: WeightSequence(rng.uniform(0, 1, (60, 2)), ["a", "b"], 15) for name in ("x", "y")
    }
    given = {}
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))
    monkeypatch.setattr(results.data, "TAKES", takes)
    monkeypatch.setattr(results.data, "load_ict_facekit", lambda: rig)
    monkeypatch.setattr(results.data, "load_take", takes.get)
    monkeypatch.setattr(
        results, "segment_face", lambda *_, **__: SimpleNamespace(labels=np.zeros(1))
    )

    def compare(learned, regions, X, targets, pieces):
        given.update(learned=learned, X=X, pieces=pieces, **targets)
        return {}

    monkeypatch.setattr(results, "compare", compare)
    monkeypatch.setattr(results, "_kept", lambda name, digest, make: make())
    results.real()
    samples, small = mesh.subsample(397)
    clean = {n: rig.on(samples, small).animate(t).displacements() for n, t in takes.items()}
    np.testing.assert_allclose(given["truth"], clean["y"], atol=1e-4)
    np.testing.assert_array_equal(given["frames"], given["X"])
    for noisy, truth in ((given["learned"], clean["x"]), (given["X"], clean["y"])):
        assert np.std(noisy - truth) == pytest.approx(0.3, rel=0.02)  # mm, as `real` says
    assert given["pieces"].tolist() == [0] * 30 + [1] * 30
