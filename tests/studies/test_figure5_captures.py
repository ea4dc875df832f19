"""Fig. 5 over captures: errors by hand, spreads counted, and the page says what the rows say."""

from pathlib import Path

import numpy as np
import pytest
from planted import bumps, quarters

from facelab.models.evaluation import rms_error
from facelab.models.region import RegionModel
from facelab.motion import MotionSequence
from facelab.segmentation.regions import Regions
from facelab.studies import figure5_captures as study
from facelab.studies.figure5 import REGION


class Actor:
    """What the study asks of a RegisteredActor: planted motion, and noise that a seed draws."""

    def __init__(self, name, seed):
        self.name = name
        self.mesh, self.labels = quarters(8, 6, 10.0)
        rng = np.random.default_rng([ord(name[0]), seed])
        self.skin = {kind: bumps(self.mesh, self.labels, rng, 30) for kind in ("train", "test")}
        self.noise = {kind: 0.1 * rng.normal(size=x.shape) for kind, x in self.skin.items()}

    def _sequence(self, X):
        return MotionSequence(self.mesh.vertices + X.reshape(len(X), -1, 3), 15, self.mesh)

    def motion(self, kind):
        return self._sequence(self.skin[kind] + self.noise[kind])

    def truth(self, kind):
        return self._sequence(self.skin[kind])


@pytest.fixture
def planted(monkeypatch):
    monkeypatch.setattr(study, "ACTORS", ("M1", "F1"))
    monkeypatch.setattr(study, "load_registered", lambda name, size, seed, **_: Actor(name, seed))
    monkeypatch.setattr(study, "face_regions", lambda actor: Regions(actor.labels, actor.mesh))


def test_every_capture_trains_and_tests_anew(planted):
    rows = study.over_captures((0, 1), sizes=(1, 3))
    assert len(rows) == 2 * 2 * 2 * 2 * 2  # captures, training sets, people, models, sizes
    (row,) = [
        r
        for r in rows
        if (r["capture"], r["training"], r["test"]) == (1, "M1+F1", "F1")
        and (r["model"], r["components"]) == (REGION, 3)
    ]
    people = [Actor(name, 1) for name in ("M1", "F1")]
    X = np.concatenate([a.motion("train").displacements() for a in people])
    model = RegionModel(Regions(people[0].labels, people[0].mesh), 3).fit(X)
    asked = people[1].motion("test").displacements()
    made, truth = model.reconstruct(asked), people[1].truth("test").displacements()
    assert row["frames_mm"] == pytest.approx(rms_error(asked, made), abs=6e-5)
    assert row["truth_mm"] == pytest.approx(rms_error(truth, made), abs=6e-5)
    assert row["truth_mm"] != row["frames_mm"]


def test_spreads_are_counted_by_hand():
    rows = [
        dict(training="A", test=person, capture=c, model=model, components=1, frames_mm=mm)
        for person, model, by_capture in (
            ("A", "holistic", (1.0, 1.5, 1.2)),
            ("A", REGION, (0.5, 0.9, 0.6)),
            ("B", "holistic", (2.0, 2.0, 2.3)),
            ("B", REGION, (1.0, 2.2, 1.0)),
        )
        for c, mm in enumerate(by_capture)
    ]
    (found,) = study.spread(rows)
    assert found["holistic"] == pytest.approx(10.0 / 6)
    assert found["holistic_spread"] == pytest.approx((0.5 + 0.3) / 2)
    assert found["regions_spread"] == pytest.approx((0.4 + 1.2) / 2)
    assert (found["won"], found["cases"]) == (5, 6)
    assert found["worst"] == pytest.approx(1.1)


def test_the_command_writes_rows_and_page(planted, monkeypatch, tmp_path, capsys):
    whole = study.over_captures
    monkeypatch.setattr(study, "over_captures", lambda size: whole(size=size, sizes=(1, 3)))
    study.main(["--out", str(tmp_path)])
    assert "48 errors" in capsys.readouterr().out
    text = (tmp_path / "figure5.md").read_text(encoding="utf-8")
    assert "3 captures" in text and "| M1+F1 | 3 |" in text
    assert (tmp_path / "figure5_captures.csv").read_text().startswith("capture,training,test")


def test_what_notebook_04_says_of_the_stored_page_holds():
    text = (Path(__file__).resolve().parents[2] / "docs/figure5.md").read_text(encoding="utf-8")
    both = text[text.index("## Against the frames") :].split("## Against the truth")
    frames, truth = (
        [line.strip("| ").split(" | ") for line in part.splitlines() if line[:4] == "| M1"]
        for part in both
    )
    assert len(frames) == len(truth) == 4 * len(study.SIZES)
    for row in [*frames, *(row for row in truth if int(row[1]) <= 10)]:
        won, cases = row[6].split(" of ")
        assert won == cases and float(row[7]) < 1
    won, cases = np.sum([list(map(int, r[6].split(" of "))) for r in truth if r[1] == "20"], axis=0)
    assert 0.4 < won / cases < 0.6  # "about half"
