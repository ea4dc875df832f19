"""Fig. 5 of Tena et al. 2011 over several captures: `python -m facelab.studies.figure5_captures`.

Notebook 04 shows one capture of the four actors. Here they perform, are captured, registered and
cut anew, so that what differs from capture to capture is told from what differs between models.
"""

import argparse
from itertools import product
from pathlib import Path

import numpy as np

from facelab.data.actors import ACTORS
from facelab.data.registered import load_registered
from facelab.models.evaluation import rms_error
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.storage import atomic_path, check_writable
from facelab.studies.benchmark_table import markdown_table
from facelab.studies.figure5 import REGION
from facelab.studies.generalisation import face_regions, write_csv

CAPTURES = (0, 1, 2)
"""Each a `random_state` of `load_registered`."""

SIZES = (1, 2, 5, 10, 20)
"""Components of the whole face, and of each region."""

FILES = "figure5_captures.csv", "figure5.md"


def errors(capture, actors, sizes=SIZES):
    """Errors of one capture: list of dict, a row for each training set, person, model and size.

    Parameters
    ----------
    capture : int
        Its name in the rows.
    actors : dict of str to RegisteredActor
        In the order in which they are added to the training set; the first one's full set gives
        the regions.
    sizes : sequence of int

    Returns
    -------
    list of dict
        With E_RMS (Eq. 13) against the registered frames and the truth behind them, millimetres.
    """
    rows, regions = [], face_regions(next(iter(actors.values())))
    train = [a.motion("train").displacements() for a in actors.values()]
    for k in range(1, len(actors) + 1):
        X = np.concatenate(train[:k])
        models = {
            "holistic": HolisticModel(max(sizes)).fit(X),
            REGION: RegionModel(regions, max(sizes)).fit(X),
        }
        for (family, model), (person, actor) in product(models.items(), actors.items()):
            asked, truth = (getattr(actor, what)("test") for what in ("motion", "truth"))
            asked, truth = asked.displacements(), truth.displacements()
            for n in sizes:
                made = model.truncated(n).reconstruct(asked)
                rows.append(
                    dict(
                        capture=capture,
                        training="+".join(list(actors)[:k]),
                        test=person,
                        model=family,
                        components=n,
                        frames_mm=round(rms_error(asked, made), 4),
                        truth_mm=round(rms_error(truth, made), 4),
                    )
                )
    return rows


def over_captures(captures=CAPTURES, size="small", sizes=SIZES, progress=True):
    """Errors of all four actors in several captures: list of dict, the rows of `errors`."""
    rows = []
    for seed in captures:
        actors = {name: load_registered(name, size, seed, progress=progress) for name in ACTORS}
        rows += errors(seed, actors, sizes)
    return rows


def spread(rows, key="frames_mm"):
    """How far errors scatter over captures, and whether regions win in each.

    Parameters
    ----------
    rows : list of dict
        From `errors`.
    key : {"frames_mm", "truth_mm"}

    Returns
    -------
    list of dict
        For each training set and size: `holistic` and `regions`, means over people and captures;
        `holistic_spread` and `regions_spread`, largest less smallest error over the captures, the
        mean over people, all in millimetres; `won` of `cases`, people and captures, in which
        regions have the smaller error; `worst`, the largest ratio of theirs to the holistic one.
    """
    found = []
    for training, n in dict.fromkeys((row["training"], row["components"]) for row in rows):
        some = [row for row in rows if (row["training"], row["components"]) == (training, n)]
        people = list(dict.fromkeys(row["test"] for row in some))
        whole, parts = (
            np.array(
                [[r[key] for r in some if (r["test"], r["model"]) == (p, model)] for p in people]
            )
            for model in ("holistic", REGION)
        )
        found.append(
            dict(
                training=training,
                components=n,
                holistic=float(whole.mean()),
                holistic_spread=float(np.ptp(whole, axis=1).mean()),
                regions=float(parts.mean()),
                regions_spread=float(np.ptp(parts, axis=1).mean()),
                won=int((parts < whole).sum()),
                cases=whole.size,
                worst=float((parts / whole).max()),
            )
        )
    return found


def as_markdown(rows, about):
    """The page: what `spread` finds, against the frames and against the truth."""
    parts = [HEAD.format(captures=len({row["capture"] for row in rows}), about=about)]
    for key, title in (("frames_mm", "Against the frames"), ("truth_mm", "Against the truth")):
        lines = [
            [
                s["training"],
                s["components"],
                *(s[k] for k in ("holistic", "holistic_spread", "regions", "regions_spread")),
                f"{s['won']} of {s['cases']}",
                s["worst"],
            ]
            for s in spread(rows, key)
        ]
        parts += [f"## {title}", markdown_table(COLUMNS, lines)]
    return "\n\n".join(parts) + "\n"


COLUMNS = (
    "trained on", "components", "whole face", "spread", "regions", "spread", "regions win",
    "worst ratio",
)  # fmt: skip

HEAD = """# Figure 5 over several captures

Made by `make results`, which leaves all rows in `results/figure5_captures.csv`. {captures} captures
of the four synthetic actors ({about}): each time they perform anew, markers sit elsewhere, and
noise, gaps and faults are others; faces and manners stay. Registered and cut anew each time.
Models of the first actors' training sentences rebuild the test sentences of all four: errors (Eq.
13) in millimetres, means over people and captures. *Spread* is the largest less the smallest error
of a person over the captures. *Regions win* counts people and captures in which 13 regions have the
smaller error at equal components of each; the *worst ratio* is the largest of theirs to that of the
whole face."""


def main(arguments=None):
    """Write the table and the page."""
    parser = argparse.ArgumentParser(
        prog="python -m facelab.studies.figure5_captures", description=__doc__
    )
    parser.add_argument("--out", default="results", type=Path, help="folder for the files")
    parser.add_argument("--size", default="small", choices=("small", "default"))
    options = parser.parse_args(arguments)
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        check_writable(out / name)  # before minutes of work
    rows = over_captures(size=options.size)
    write_csv(out / FILES[0], rows)
    kind = {"small": "few sentences each, a coarse face", "default": "all their takes"}
    with atomic_path(out / FILES[1]) as part:
        Path(part).write_text(as_markdown(rows, kind[options.size]), encoding="utf-8")
    print(f"{len(rows)} errors in {out / FILES[0]}, summed up in {out / FILES[1]}")


if __name__ == "__main__":
    main()
