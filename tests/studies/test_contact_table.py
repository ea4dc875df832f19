"""The table of crossings before and after lips are held off each other."""

from pathlib import Path

import numpy as np
from planted import bumpy_rig

from facelab.studies import contact_table as module


class Planted:
    """Parts what is at 0 by moving one vertex by 2 mm: three crossings become one."""

    def off(self, vertices):
        if vertices[0, 0] > 0:
            return vertices
        moved = vertices.copy()
        moved[0] += [0, 0, 2]
        return moved

    def counts(self, vertices):
        crosses = vertices[0, 0] == 0
        parted = vertices[0, 2] == 2
        return {
            "mouth": (int(crosses) * (1 if parted else 3), 99, 4 - parted),
            "eye_left": (0, 99, 1),
        }


def test_crossings_folds_and_pushes_are_summed_as_they_were_planted():
    faces = np.zeros((3, 5, 3))
    faces[2, :, 0] = 1  # does not cross
    row = module.counted(Planted(), faces)
    assert (row["crossings"], row["crossings_after"]) == (6, 2)
    assert (row["folds"], row["folds_after"]) == (15, 13)
    assert (row["faces"], row["mean_mm"], row["most_mm"]) == (3, 2.0, 2.0)


def test_the_page_says_what_share_is_gone_and_what_was_not_at_hand():
    row = module.counted(Planted(), np.zeros((3, 5, 3)))
    page = module.as_markdown([dict(source="A", target="B", **row)], ["Aura"])
    assert "| A to B | 3 | 9 | 3 | 67 % |" in page and "left out: Aura." in page


def test_weights_are_mixtures_and_frames_spread_over_the_takes():
    rig = bumpy_rig()
    take = rig.plausible_mixtures(50, random_state=1)
    W = module.weights_of(rig, [take], 4)
    assert W.shape == (8, len(rig.names))
    np.testing.assert_array_equal(W[:4], rig.plausible_mixtures(4).weights)
    np.testing.assert_allclose(W[4:], take.weights[[9, 19, 29, 39]])


def test_the_page_in_the_repository_has_crossings_down_and_folds_not_up_on_every_pair():
    page = Path(__file__).resolve().parents[2] / "docs/contact.md"
    text = page.read_text(encoding="utf-8")
    assert text.startswith(module.HEAD), "made anew by `make results`"
    lines = [line.split("|")[2:-1] for line in text.splitlines() if " to " in line and "|" in line]
    assert len(lines) == 7
    for faces, before, after, _, folds, folds_after, *_ in np.array(lines, dtype=object):
        assert int(faces) >= 12 and int(after) < 0.15 * int(before)
        assert int(folds_after) <= int(folds)
