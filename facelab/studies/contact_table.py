"""Lips and lids that cross when a face is carried: `python -m facelab.studies.contact_table`.

Frames of takes and random mixtures of shapes go to other faces; crossings are counted before and
after `Contact` holds lips and lids off each other.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from facelab import data
from facelab.expression.contact import Contact
from facelab.expression.transfer import IntermediateSpace
from facelab.storage import atomic_path, check_writable
from facelab.studies.benchmark_table import markdown_table
from facelab.studies.generalisation import write_csv
from facelab.studies.translation_table import at_hand

FRAMES = 12
"""Of takes, and as many mixtures, for each pair of faces."""

_STILL = 0.01  # mm: skin that is pushed by less counts as not moved
FILES = "contact.csv", "contact.md"


def counted(contact, faces):
    """What `contact` does to posed faces: dict of counts, millimetres and milliseconds.

    Parameters
    ----------
    contact : Contact
    faces : iterable of ndarray of shape (n_vertices, 3)
        Millimetres.

    Returns
    -------
    dict
        `crossings` and `crossings_after`, pairs of triangles of two sheets beyond those at rest;
        `folds` and `folds_after`, pairs within one sheet; `mean_mm` of the skin that was pushed and
        `most_mm` of any; `ms` a face.
    """
    sums, pushes, seconds = np.zeros(4, dtype=int), [np.zeros(0)], []
    for before in faces:
        began = time.process_time()
        after = contact.off(before)
        seconds.append(time.process_time() - began)
        (more, folds), (more_after, folds_after) = (
            np.sum([(a, c) for a, _, c in contact.counts(V).values()], axis=0)
            for V in (before, after)
        )
        sums += [more, more_after, folds, folds_after]
        push = np.linalg.norm(after - before, axis=1)
        pushes.append(push[push > _STILL])
    pushes = np.concatenate(pushes)
    keys = "crossings", "crossings_after", "folds", "folds_after"
    return dict(
        faces=len(seconds),
        **dict(zip(keys, sums.tolist(), strict=True)),
        mean_mm=round(float(pushes.mean()) if len(pushes) else 0.0, 3),
        most_mm=round(float(pushes.max(initial=0)), 3),
        ms=round(1000 * float(np.mean(seconds)), 1),
    )


def weights_of(rig, takes, n_frames=FRAMES, random_state=0):
    """Rows of weights, evenly from takes, and as many random mixtures: (n, n_shapes)."""
    rows = list(rig.plausible_mixtures(n_frames, random_state=random_state).weights)
    for take in takes:
        W = rig.rig_weights(take)[np.flatnonzero(take.valid)]
        rows += list(W[np.linspace(0, len(W) - 1, n_frames // len(takes) + 2, dtype=int)[1:-1]])
    return np.array(rows)


def all_pairs():
    """Rows of every pair of which the faces are here, and what was left out: two lists."""
    rows, (face, aura, takes, without) = [], at_hand()
    takes = list((takes or {}).values())
    actors = {n: data.load_capture(n, "small").rig.linear() for n in data.ACTORS}
    pairs = [("M1", actors["M1"], [], "F1", actors["F1"].neutral)]
    if face:
        pairs += [("generic face", face, takes, name, rig.neutral) for name, rig in actors.items()]
    if face and aura:
        pairs.append(("generic face", face, takes, "Aura", aura[0].neutral))
        pairs.append(("Aura", aura[0], [aura[1]], "generic face", face.neutral))
    for name, rig, own, other, target in pairs:
        space, contact = IntermediateSpace(rig, target), Contact(target)
        faces = (space.to_target(space.rig.shape(w)) for w in weights_of(rig, own))
        rows.append(dict(source=name, target=other, **counted(contact, faces)))
    return rows, without


def as_markdown(rows, without=()):
    """The page: a line for each pair, and what was not at hand."""
    lines = [
        [
            f"{r['source']} to {r['target']}",
            *(r[k] for k in ("faces", "crossings", "crossings_after")),
            f"{100 * (1 - r['crossings_after'] / max(r['crossings'], 1)):.0f} %",
            *(r[k] for k in ("folds", "folds_after", "mean_mm", "most_mm")),
            f"{r['ms']:.0f}",
        ]
        for r in rows
    ]
    parts = [HEAD, markdown_table(COLUMNS, lines)]
    if without:
        parts.append(f"Not at hand, and so left out: {', '.join(without)}.")
    return "\n\n".join(parts) + "\n"


COLUMNS = (
    "pair", "faces", "crossings", "with contact", "fewer", "folds", "with contact",
    "pushed, mm", "most, mm", "ms a face",
)  # fmt: skip

HEAD = f"""# Lips and lids held off each other

Made by `make results`, which leaves the rows in `results/contact.csv`. Up to {FRAMES} frames of
takes and {FRAMES} random mixtures of shapes are carried to another face by `IntermediateSpace`,
without and with `contact=True`. *Crossings* are pairs of triangles of the two lips, or of the two
lids of an eye, that cut through each other and do not at rest, *folds* such pairs within one lip or
lid; both are summed over all faces. *Pushed* is the mean over the skin that moves by more than
{_STILL:g} mm."""


def main(arguments=None):
    """Write the table and the page."""
    parser = argparse.ArgumentParser(
        prog="python -m facelab.studies.contact_table", description=__doc__
    )
    parser.add_argument("--out", default="results", type=Path, help="folder for the files")
    out = parser.parse_args(arguments).out
    out.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        check_writable(out / name)  # before minutes of work
    rows, without = all_pairs()
    write_csv(out / FILES[0], rows)
    with atomic_path(out / FILES[1]) as part:
        Path(part).write_text(as_markdown(rows, without), encoding="utf-8")
    print(f"{len(rows)} pairs of faces in {out / FILES[1]}")


if __name__ == "__main__":
    main()
