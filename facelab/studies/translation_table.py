"""The translator and its peers over pairs of rigs: `python -m facelab.studies.translation_table`.

Aura's animation goes to the generic face and back, recorded takes go from the generic face to Aura
and to the synthetic actors and back, each in four ways (see `translation.trip`).
"""

import argparse
from pathlib import Path

import numpy as np

from facelab import data
from facelab.names import arkit_names
from facelab.storage import atomic_path, check_writable
from facelab.studies.benchmark_table import markdown_table
from facelab.studies.generalisation import write_csv
from facelab.studies.translation import AURA_BY_NAME, both_ways, trip, turned

FPS = 3.0
"""Frames a second that are translated: deformation transfer solves for a whole face in each."""

WAYS = {
    "names": "by names",
    "nearest": "nearest shapes",
    "transfer": "deformation transfer",
    "map": "translate",
}
"""Ways of `translation.trip`, and what the page calls them."""

FILES = "translation.csv", "translation.md"


def names_of(rig, other):
    """Shapes of `other` that mean what each shape of `rig` means in ARKit: dict of str to tuple.

    Examples
    --------
    >>> import facelab
    >>> rig = facelab.load_example().rig
    >>> names_of(rig, rig.renamed({"jawOpen": "AU26"}))["jawOpen"]
    ('AU26',)
    """
    meant = {name: set(arkit_names(name)) for name in other.names}
    table = {a: tuple(b for b, m in meant.items() if m & set(arkit_names(a))) for a in rig.names}
    return {a: found for a, found in table.items() if found}


def errors(about, pair, takes, names, fps=FPS):
    """A row for each take and way: list of dict.

    Parameters
    ----------
    about : dict of str to str
        First columns of each row: what is translated, `way` and `take` aside.
    pair : tuple of Translator
        From `translation.both_ways`.
    takes : dict of str to WeightSequence
        Of `pair[0].rig`.
    names : dict of str to tuple of str
        See `translation.by_names`.
    fps : float
        To which takes are thinned.

    Returns
    -------
    list of dict
        With what `translation.Trip` has: millimetres, shares, frames a second.
    """
    rows = []
    for take, weights in takes.items():
        thin = weights.resampled(min(fps, weights.fps))
        for way in WAYS:
            t = trip(*pair, thin, way, names)
            rows.append(
                dict(
                    **about,
                    take=take,
                    way=way,
                    frames=thin.n_frames,
                    moves_mm=round(t.moves, 4),
                    left_mm=round(t.left, 4),
                    lost=round(t.lost, 5),
                    weights_off=round(t.off, 5),
                    active=round(t.active, 2),
                    per_second=round(t.per_second, 1),
                )
            )
    return rows


def at_hand():
    """The generic face, Aura with its animation, and the recorded takes, where they are here.

    Returns
    -------
    face : BlendshapeRig or None
    aura : (BlendshapeRig, WeightSequence) or None
    takes : dict of str to WeightSequence or None
    without : list of str
        What is not here, in words.
    """
    without = []

    def here(what, load):
        try:
            return load()
        except data.DataUnavailable:
            without.append(what)

    face = here("the generic face", data.load_ict_facekit)
    aura = here("Aura", lambda: (data.load_aura(), data.load_aura_take()))
    takes = here("the recorded takes", lambda: {n: data.load_take(n) for n in data.TAKES})
    return face, aura, takes, without


def all_pairs():
    """Rows of every pair of which the rigs and takes are here, and what was left out: two lists."""
    rows, (face, aura, takes, without) = [], at_hand()
    if face and aura:
        there, back = both_ways(aura[0], face)
        about = dict(rig="Aura", other="generic face")
        rows += errors(about, (there, back), {"its animation": aura[1]}, AURA_BY_NAME)
        if takes:
            about = dict(rig="generic face", other="Aura")
            rows += errors(about, (back, there), takes, turned(AURA_BY_NAME))
    if face and takes:
        for actor in data.ACTORS:
            other = data.load_capture(actor, "small").rig.linear()
            about = dict(rig="generic face", other=f"actor {actor}")
            rows += errors(about, both_ways(face, other), takes, names_of(face, other))
    return rows, without


def summed(rows):
    """Lines of the page's table: takes of a pair, and the actors, as their means: list of list."""
    groups = {}
    for row in rows:
        other = "synthetic actors" if row["other"].startswith("actor ") else row["other"]
        groups.setdefault((row["rig"], other), {}).setdefault(row["way"], []).append(row)
    lines = []
    for (rig, other), ways in groups.items():
        named = _mean(ways["names"], "left_mm")
        for way, some in ways.items():
            left = _mean(some, "left_mm")
            lines.append(
                [
                    f"{rig} to {other}",
                    WAYS[way],
                    *(_mean(some, "moves_mm"), left),
                    None if way == "names" else f"{100 * (1 - left / named):.0f} %",
                    f"{100 * _mean(some, 'lost'):.0f} %",
                    _mean(some, "weights_off"),
                    *(f"{_mean(some, key):.0f}" for key in ("active", "per_second")),
                ]
            )
    return lines


def _mean(rows, key):
    return float(np.mean([row[key] for row in rows]))


def as_markdown(rows, without=()):
    """The page: what `summed` finds, and what was not at hand."""
    parts = [HEAD, markdown_table(COLUMNS, summed(rows))]
    if without:
        parts.append(f"Not at hand, and so left out: {', '.join(without)}.")
    return "\n\n".join(parts) + "\n"


COLUMNS = (
    "pair", "way", "moves, mm", "left, mm", "nearer than by names", "lost there and back",
    "weights off", "active", "frames/s",
)  # fmt: skip

HEAD = f"""# Weights from rig to rig, and back

Made by `make results`, which leaves all rows in `results/translation.csv`. Aura is a production
head of 72 shapes with 2,800 frames of animation, the generic face that of ICT-FaceKit with 53; the
two recorded takes of one performer drive the generic face; the four synthetic actors have 40 action
units each, on a coarse face. Takes are thinned to {FPS:g} frames a second. Means over takes and
actors.

- *By names*: each shape drives those that a person would name for it: for Aura a table made by
  hand, for the actors what both are in ARKit.
- *Nearest shapes*: weights within 0 and 1 whose shapes come nearest on one face, frame by frame.
- *Deformation transfer* (Sumner and Popović 2004, triangles weighted by area, on the fitted
  template): each frame is carried to the other face itself and read there by its nearest shapes.
- *translate*: `facelab.expression.translate` as it is, sparse and smooth.

*Moves* is how far the take moves the face, *left* what the translated one leaves of that: RMS over
the face and all frames, on the face on which `translate` compares both rigs. *Lost* is the share of
the motion that is missing or added on the own face after the way there and back, *weights off* the
mean error of the weights there and back as a share of their mean (1 for a face at rest). *Active*
are shapes above 0.01 in a frame. *Frames a second* of one processor, once the pair is prepared.
Names never look at the shapes, so the weights of what both sides name come back as they were; what
only one side names is lost."""


def main(arguments=None):
    """Write the table and the page."""
    parser = argparse.ArgumentParser(
        prog="python -m facelab.studies.translation_table", description=__doc__
    )
    parser.add_argument("--out", default="results", type=Path, help="folder for the files")
    out = parser.parse_args(arguments).out
    out.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        check_writable(out / name)  # before a minute of work
    rows, without = all_pairs()
    if not rows:
        raise SystemExit(f"not at hand: {', '.join(without)}; no pair of rigs is left.")
    write_csv(out / FILES[0], rows)
    with atomic_path(out / FILES[1]) as part:
        Path(part).write_text(as_markdown(rows, without), encoding="utf-8")
    print(f"{len(rows)} trips in {out / FILES[0]}, summed up in {out / FILES[1]}")


if __name__ == "__main__":
    main()
