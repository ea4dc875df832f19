"""The benchmark as tables: `make results`, or `python -m facelab.studies.benchmark_table`.

Writes `benchmark.csv`, `locality.csv`, `capture.csv` and `benchmark.md`, which sums them up.
"""

import argparse
from itertools import islice
from pathlib import Path

import numpy as np

from facelab import data
from facelab.storage import atomic_path, check_writable
from facelab.studies import benchmark, benchmark_capture, benchmark_data
from facelab.studies.generalisation import write_csv

PEERS = ("holistic", "regions")
"""What a model is measured against."""

FILES = ("benchmark.csv", "locality.csv", "capture.csv", "benchmark.md")


def medians(rows, by, key):
    """Median of `key` over the rows that agree: nested dict, a level for each name in `by`."""
    if not by:
        return float(np.median([row[key] for row in rows]))
    groups = {}
    for row in rows:
        groups.setdefault(row[by[0]], []).append(row)
    return {name: medians(some, by[1:], key) for name, some in groups.items()}


def against_best(rows, model, peers=PEERS):
    """Error against the truth over that of the better peer at equal parameters, for each pair.

    Parameters
    ----------
    rows : list of dict
        From `benchmark.run`.
    model : str
    peers : sequence of str

    Returns
    -------
    dict of (data, rich, training, test, size) to float
    """
    found = {}
    for row in rows:
        if row["spread"] == "total":
            pair = tuple(row[k] for k in ("data", "rich", "training", "test", "size"))
            found.setdefault(pair, {})[row["model"]] = row["truth_mm"]
    return {
        pair: by_model[model] / min(by_model[peer] for peer in peers)
        for pair, by_model in found.items()
        if model in by_model and all(peer in by_model for peer in peers)
    }


def markdown_table(head, lines):
    """A table in Markdown, one string; None is left empty, numbers have three digits."""
    text = [head, ["---"] + ["---:"] * (len(head) - 1)]
    text += [
        ["" if x is None else f"{x:.3f}" if isinstance(x, float) else x for x in line]
        for line in lines
    ]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in text)


def _by_size(rows, corner, key="truth_mm"):
    """Medians of one data set, a line for each model and a column for each size."""
    table = medians(rows, ("model", "size"), key)
    sizes = sorted({row["size"] for row in rows})
    lines = [[model, *(found.get(n) for n in sizes)] for model, found in table.items()]
    return markdown_table([corner, *map(str, sizes)], lines)


def summary(rows):
    """How each model stands against the better of its peers: list of lines for a table."""
    lines = []
    groups = dict.fromkeys((row["data"], row["rich"]) for row in rows)
    for name, rich in groups:
        some = [row for row in rows if (row["data"], row["rich"]) == (name, rich)]
        for model in dict.fromkeys(row["model"] for row in some if row["spread"] == "total"):
            ratios = np.array(list(against_best(some, model).values()))
            if model not in (*PEERS, "rotated") and len(ratios):
                lines.append(
                    [
                        model,
                        f"{name}, {rich}",
                        f"{(ratios < 1).sum()} of {len(ratios)}",
                        float(np.median(ratios)),
                        float(ratios.max()),
                    ]
                )
    return sorted(lines, key=lambda line: line[0])


def as_markdown(errors, locality, capture):
    """All tables and what they say, as one text."""
    parts = [HEAD]
    for name, rich in dict.fromkeys((row["data"], row["rich"]) for row in errors):
        some = [row for row in errors if (row["data"], row["rich"]) == (name, rich)]
        trained = ", ".join(dict.fromkeys(row["training"] for row in some))
        tested = ", ".join(dict.fromkeys(row["test"] for row in some))
        parts.append(f"## {name}, {rich} training\n\nTrained on {trained}; asked about {tested}.")
        rigs = [row for row in some if row["spread"] == "rig"]
        for spread, corner in (("total", "parameters in all"), ("each", "modes each")):
            of = [row for row in some if row["spread"] == spread]
            parts.append(_by_size(of, corner))
        if rigs:
            truth = medians(rigs, (), "truth_mm")
            parts.append(f"Blendshapes of the trained face, {rigs[0]['size']}: {truth:.3f} mm.")
    parts.append(AGAINST)
    head = ["model", "data", "better in", "median ratio", "worst ratio"]
    parts.append(markdown_table(head, summary(errors)))
    parts.append(LOCALITY)
    lines = []
    for spread, corner in (("total", "in all"), ("each", "each"), ("rig", "shapes")):
        of = [row for row in locality if row["spread"] == spread]
        for size in sorted({row["size"] for row in of}):
            for model in dict.fromkeys(row["model"] for row in of):
                some = [row for row in of if (row["model"], row["size"]) == (model, size)]
                equal = [row for row in some if row["far_equal_mm"] is not None]
                if some:
                    lines.append(
                        [
                            model,
                            f"{size} {corner}",
                            medians(some, (), "followed_mm"),
                            medians(some, (), "far_mm"),
                            medians(equal, (), "far_equal_mm") if equal else None,
                        ]
                    )
    head = ["model", "size", "corner follows", "beyond 40 mm", "beyond, at equal following"]
    parts.append(markdown_table(head, lines))
    if capture:
        parts.append(CAPTURE)
        models = [row | dict(size=row["parameters"] or 0) for row in capture]
        parts.append(_by_size(models, "parameters (0: no model)", "left_out_mm"))
    return "\n\n".join(parts) + "\n"


HEAD = f"""# Linear face models side by side

Made by `make results`, which leaves all rows in `results/benchmark.csv`. Root mean square error
against the truth, millimetres, the median over all pairs of a take learned from and a take asked
about. Both are noisy ({benchmark_data.NOISE} mm an axis; the actors' frames are registered
markers), all on 397 vertices. *Parameters* are what is keyed or sent for a frame. *Modes each* go
to every region, and to the whole face beside it: the axis of memory and arithmetic, for M regions
of P modes store about as many numbers as P modes of the whole face.

The generic face and Aura move linearly in the shapes of their rigs, which rebuild them but for the
noise. Rotated modes span what the holistic ones do: their errors are the same. Sparse localised
components follow public descriptions of Neumann et al. 2013 and are learned up to
{benchmark.SPARSE_MOST}. "Global, then regions" has {benchmark.GLOBAL} modes of the whole face
before regions of the rest. "Global and local" is `GlobalLocalModel`; "holistic, shrunk" is the same
with nothing local in it."""

AGAINST = """## Against the better of holistic and regions, at equal parameters

"Global and local" was made on the pairs of the generic face, to be never worse than 1.02 times the
better of both there, and better by the median; the actors and Aura were not looked at for it. With
20 parameters it mostly chooses to be the holistic model; that it does not on Aura's rich half is
its worst ratio. Shrinkage alone gives what "holistic, shrunk" has, the local modes the rest. It
stores whole-face modes: at equal memory and arithmetic it costs what the holistic model does, and
regions of as many modes each are nearer to the truth."""

LOCALITY = f"""## Locality

The left corner of the mouth is pulled by 8 mm (beta 0.5, gamma 0.025): how far it follows, and how
much moves beyond 40 mm of it (root mean square, mm); then the same with the gamma at which it
follows {benchmark.FOLLOWED:g} mm. Medians over the rich training takes.

Regions stay what the posing lab starts with: each of their sliders moves one region, and a face is
molded region by region; one basis of the whole face, however local its answers, has neither."""

CAPTURE = """## A real capture

41 markers (AnimFace, Miguel Ramos Carretero, CC BY-SA 4.0). Models of the first halves of both
takes are asked about the second halves, each marker left out in turn and told from the others: RMS
in mm. There is no dense truth, and no other face: whole-face modes tell a marker best."""


def main(arguments=None):
    """Write the tables; say what is missing."""
    parser = argparse.ArgumentParser(
        prog="python -m facelab.studies.benchmark_table", description=__doc__
    )
    parser.add_argument("--out", default="results", type=Path, help="folder for the files")
    parser.add_argument(
        "--quick", action="store_true", help="one training take and few sizes, to see that it runs"
    )
    options = parser.parse_args(arguments)
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        check_writable(out / name)  # before minutes of work
    if options.quick:
        some = islice(benchmark.tasks(), 1)
        errors, locality = benchmark.run(some, sizes=(20, 60), each=(5, 10))
    else:
        errors, locality = benchmark.run(benchmark.tasks())
    try:
        capture = benchmark_capture.capture_rows()
    except data.DataUnavailable as missing:
        print(f"Left out: {missing}")
        capture = []
    for name, rows in zip(FILES, (errors, locality, capture), strict=False):
        if rows:
            write_csv(out / name, rows)
    with atomic_path(out / FILES[-1]) as part:
        Path(part).write_text(as_markdown(errors, locality, capture), encoding="utf-8")
    print(f"{len(errors)} errors in {out / FILES[0]}, summed up in {out / FILES[-1]}")


if __name__ == "__main__":
    main()
