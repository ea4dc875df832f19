import csv
import re
from pathlib import Path
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from planted import bumps, corner_regions

from facelab import data
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.rig import BlendshapeRig
from facelab.studies import benchmark, benchmark_capture, benchmark_figures, benchmark_table
from facelab.studies.benchmark_data import Asked, Task


class Planted(Task):
    """A task of 42 vertices whose regions are known."""

    def regions(self):
        return corner_regions()


@pytest.fixture(scope="module")
def task():
    regions, rng = corner_regions(), np.random.default_rng(2)
    labels = np.zeros(42, int)
    for i, members in enumerate(regions.members):
        labels[members] = i
    truth = bumps(regions.mesh, labels, rng, 90)
    shapes = np.linalg.svd(truth, full_matrices=False)[2][:8].reshape(8, 42, 3)
    rig = BlendshapeRig(regions.mesh, [f"s{k}" for k in range(8)], 40 * shapes)
    noisy = truth + rng.normal(scale=0.1, size=truth.shape)
    asked = tuple(Asked(name, noisy[i::3], truth[i::3]) for i, name in ((1, "b"), (2, "c")))
    return Planted("planted", "a", True, noisy[::3], regions.mesh, 20, asked, rig)


@pytest.fixture(scope="module")
def models(task):
    return list(benchmark.entries(task, sizes=(12, 20), each=(2, 5)))


@pytest.fixture(scope="module")
def rows(task, models):
    return benchmark.error_rows(task, models)


def test_every_family_is_asked_about_every_take(rows):
    families = {"holistic", "rotated", "regions", "global, then regions", "global and local"}
    families |= {"sparse localised", "holistic, shrunk"}
    for family in families:
        for size in (12, 20):
            of = [
                r for r in rows if (r["model"], r["spread"], r["size"]) == (family, "total", size)
            ]
            assert [r["test"] for r in of] == ["b", "c"], (family, size)
            if family != "sparse localised":  # empty components are left out
                assert {r["parameters"] for r in of} == {size}
    assert {r["size"] for r in rows if r["spread"] == "rig"} == {8}


def test_turned_modes_make_the_same_errors(rows):
    of = {
        f: [r["truth_mm"] for r in rows if r["model"] == f and r["spread"] == "total"]
        for f in ("holistic", "rotated")
    }
    assert of["rotated"] == of["holistic"]


def test_errors_are_those_of_models_fitted_by_hand(task, rows):
    X_hat = RegionModel(corner_regions(), 5).fit(task.X).reconstruct(task.asked[0].frames)
    expected = np.sqrt(((X_hat - task.asked[0].truth).reshape(-1, 3) ** 2).sum(axis=1).mean())
    (row,) = [
        r
        for r in rows
        if (r["model"], r["spread"], r["size"], r["test"]) == ("regions", "each", 5, "b")
    ]
    assert row["truth_mm"] == pytest.approx(expected, abs=6e-5)
    assert row["parameters"] == 20


def test_a_model_stores_what_is_not_zero_in_its_bases(task):
    regions = corner_regions()
    whole, split = HolisticModel(4).fit(task.X), RegionModel(regions, 4).fit(task.X)
    assert benchmark.stored_components(whole) == 4
    held = sum(map(len, regions.members)) / 42
    assert benchmark.stored_components(split) == pytest.approx(4 * held)
    both = benchmark.GlobalThenRegions(whole, split)
    assert benchmark.stored_components(both) == pytest.approx(4 + 4 * held)


def test_regions_after_global_modes_rebuild_what_those_leave(task):
    X, regions = task.X, corner_regions()
    whole = HolisticModel(3).fit(X)
    left = X - whole.reconstruct(X)
    rest = RegionModel(regions, 4).fit(left)
    both = benchmark.GlobalThenRegions(whole, rest)
    np.testing.assert_allclose(both.reconstruct(X), X - left + rest.reconstruct(left), atol=1e-12)
    assert both.basis.shape == (both.n_coefficients, 42, 3) == (19, 42, 3)
    L = both.boundary()
    assert (L[:3] == 0).all() and np.array_equal(L[3:, 3:], rest.boundary())


def test_at_equal_following_the_vertex_follows_so_far(task, models):
    seen = 0
    for entry in models:
        found = benchmark.pulled_equally(entry.model, task.mesh, task.corner, 5.0)
        if found is not None:
            followed, far = benchmark.pulled(entry.model, task.mesh, task.corner, found[0])
            assert followed == pytest.approx(5.0, abs=0.01) and far == pytest.approx(found[1])
            seen += 1
    assert seen >= 5
    stiff = HolisticModel(1).fit(np.eye(126)[:5])
    assert benchmark.pulled_equally(stiff, task.mesh, task.corner, 7.9) is None


def test_a_row_of_locality_has_both_ways(task, models, monkeypatch):
    monkeypatch.setattr(benchmark, "LOCAL_SIZES", {"total": (12,), "each": (2,)})
    rows = benchmark.locality_rows(task, models)
    assert {(r["spread"], r["size"]) for r in rows} == {("total", 12), ("each", 2), ("rig", 8)}
    assert all(r["followed_mm"] <= 8 and r["far_mm"] >= 0 for r in rows)


def test_left_out_markers_are_told_by_the_conditional_mean(rng):
    X = rng.normal(size=(60, 4)) @ rng.normal(size=(4, 15)) + rng.normal(scale=0.2, size=(60, 15))
    model = HolisticModel(6).fit(X)
    B, v = model.components_[0], model.variances_[0]
    s2 = benchmark_capture.NOISE**2
    K = B.T @ np.diag(v) @ B  # Gaussian: the mean of some coordinates where the others are given
    squares = []
    for i in range(5):
        at = np.arange(3 * i, 3 * i + 3)
        o = np.setdiff1d(np.arange(15), at)
        D = X - model.mean_
        told = D[:, o] @ np.linalg.solve(K[np.ix_(o, o)] + s2 * np.eye(12), K[np.ix_(o, at)])
        squares.append(((D[:, at] - told) ** 2).sum(axis=1))
    expected = np.sqrt(np.mean(squares))
    assert benchmark_capture.left_out_error(model, X) == pytest.approx(expected, rel=1e-6)


# --- tables ---------------------------------------------------------------------------------------


def row(model, training, size, mm, spread="total"):
    return dict(
        data="d",
        rich="rich",
        training=training,
        test="t",
        model=model,
        spread=spread,
        size=size,
        truth_mm=mm,
    )


def test_a_model_is_measured_against_the_better_of_both_at_equal_parameters():
    rows = [
        row("holistic", "a", 20, 2.0),
        row("regions", "a", 20, 4.0),
        row("new", "a", 20, 1.0),
        row("holistic", "b", 20, 5.0),
        row("regions", "b", 20, 4.0),
        row("new", "b", 20, 6.0),
        row("new", "b", 60, 6.0),
        row("new", "a", 20, 0.1, "each"),
    ]
    ratios = benchmark_table.against_best(rows, "new")
    assert sorted(ratios.values()) == [0.5, 1.5]
    assert benchmark_table.summary(rows) == [["new", "d, rich", "1 of 2", 1.0, 1.5]]


def test_medians_are_taken_over_pairs():
    rows = [row("m", t, n, mm) for t, n, mm in (("a", 1, 1.0), ("b", 1, 2.0), ("c", 1, 9.0))]
    assert benchmark_table.medians(rows, ("model", "size"), "truth_mm") == {"m": {1: 2.0}}


def test_the_command_writes_all_tables_and_says_what_is_missing(
    task, tmp_path, monkeypatch, capsys
):
    def unavailable(*_):
        raise data.DataUnavailable("no capture here")

    monkeypatch.setattr(benchmark, "tasks", lambda: iter([task]))
    monkeypatch.setattr(benchmark, "SPARSE_MOST", 20)
    monkeypatch.setattr(benchmark_capture, "capture_rows", unavailable)
    benchmark_table.main(["--quick", "--out", str(tmp_path)])
    assert "Left out: no capture here" in capsys.readouterr().out
    with open(tmp_path / "benchmark.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {"holistic", "regions"} <= {r["model"] for r in rows}
    text = (tmp_path / "benchmark.md").read_text(encoding="utf-8")
    assert "## planted, rich training" in text and "A real capture" not in text
    assert not (tmp_path / "capture.csv").exists()


def test_data_that_cannot_be_had_are_said_and_left_out(monkeypatch, capsys):
    def missing():
        raise data.DataUnavailable("no face here")
        yield

    there = SimpleNamespace(name="there")
    monkeypatch.setattr(benchmark.benchmark_data, "actor_tasks", lambda progress: iter([there]))
    monkeypatch.setattr(benchmark.benchmark_data, "generic_tasks", missing)
    monkeypatch.setattr(benchmark.benchmark_data, "aura_tasks", missing)
    assert list(benchmark.tasks()) == [there]
    assert capsys.readouterr().out.count("Left out: no face here") == 2


def test_the_figure_shows_medians_and_names_its_axes(rows):
    locality = [
        dict(model="regions", spread="total", size=12, far_equal_mm=0.25),
        dict(model="regions", spread="total", size=20, far_equal_mm=None),
    ]
    fig = benchmark_figures.compared(rows, locality, "planted")
    left, right = fig.axes
    lines = {line.get_label(): line for line in left.lines}
    of = [
        r["truth_mm"]
        for r in rows
        if (r["model"], r["spread"], r["size"]) == ("regions", "total", 12)
    ]
    assert lines["regions"].get_ydata()[0] == np.median(of)
    assert [line.get_xdata()[0] for line in right.lines] == [0.25]
    assert "mm" in left.get_ylabel() and "mm" in right.get_xlabel()
    plt.close(fig)


ROOT = Path(__file__).resolve().parents[2]


def stored_tables():
    """The tables of docs/benchmark.md: heading to list of rows, each a dict by column."""
    found, heading = {}, None
    for line in (ROOT / "docs/benchmark.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            heading, head = line[3:], None
        elif line.startswith("|"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            if found.get(heading) is None or head is None or cells[0] in ("model", "modes each"):
                head = cells
                found.setdefault(heading, [])
            elif not cells[0].startswith("---"):
                found[heading].append(dict(zip(["", *head[1:]], cells, strict=True)))
    return found


def test_the_readme_says_what_the_stored_table_says():
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    said = re.search(
        r"at (\d+) parameters holistic modes are ([\d.]+) mm from the truth, regions ([\d.]+), "
        r"`GlobalLocalModel` ([\d.]+); it is better than the better of both in (\d+ of \d+)",
        text,
    )
    size, holistic, regions, between, better = said.groups()
    tables = stored_tables()
    of = {row[""]: row for row in tables["generic face, rich training"] if size in row}
    stored = [of[family][size] for family in ("holistic", "regions", "global and local")]
    assert [holistic, regions, between] == stored
    against = tables["Against the better of holistic and regions, at equal parameters"]
    (row,) = [
        r for r in against if (r[""], r["data"]) == ("global and local", "generic face, rich")
    ]
    assert better == row["better in"]


def test_the_words_beside_the_stored_tables_hold():
    tables = stored_tables()
    ratios = tables["Against the better of holistic and regions, at equal parameters"]
    worst = {r["data"]: float(r["worst ratio"]) for r in ratios if r[""] == "global and local"}
    assert worst.pop("Aura, rich") > max(worst.values())
    assert max(worst.values()) <= 1.02
    assert max(float(r["median ratio"]) for r in ratios if r[""] == "global and local") < 1
    told = {r[""]: r for r in tables["A real capture"]}
    for size in ("10", "20", "40", "80"):
        of = {family: float(told[family][size]) for family in told if told[family][size]}
        assert min(of.values()) == of["holistic"]
    pulled = {(r[""], r["size"]): r for r in tables["Locality"]}
    for size in ("60 in all", "130 in all"):
        far = {
            f: float(pulled[f, size]["beyond, at equal following"])
            for f in ("holistic", "regions", "global and local")
        }
        assert min(far, key=far.get) == "global and local"
