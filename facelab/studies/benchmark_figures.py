"""The benchmark in one figure: errors against size, and against how far a pull reaches."""

import matplotlib.pyplot as plt
import numpy as np

STYLES = {
    "holistic": ("tab:gray", "-", "o"),
    "regions": ("tab:blue", "-", "s"),
    "global, then regions": ("tab:cyan", "--", "^"),
    "sparse localised": ("tab:green", "--", "v"),
    "global and local": ("tab:red", "-", "D"),
}
"""Colour, line and mark of each family; rotated modes lie on the holistic ones."""


def compared(errors, locality, title=None):
    """Models side by side: a figure of two panels.

    Left, the error against the truth by parameters in all; right, by motion beyond 40 mm of a
    pulled vertex at equal following, nearer to the corner being better in both.

    Parameters
    ----------
    errors, locality : list of dict
        From `facelab.studies.benchmark.run`, of one data set.
    title : str, optional
        Names the data.

    Returns
    -------
    matplotlib.figure.Figure
    """
    fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for family, (color, line, mark) in STYLES.items():
        of = [r for r in errors if r["model"] == family and r["spread"] == "total"]
        sizes = sorted({r["size"] for r in of})
        error = {n: np.median([r["truth_mm"] for r in of if r["size"] == n]) for n in sizes}
        left.plot(sizes, [error[n] for n in sizes], line, color=color, marker=mark, label=family)
        for n in sizes:
            far = [
                r["far_equal_mm"]
                for r in locality
                if (r["model"], r["spread"], r["size"]) == (family, "total", n)
                and r["far_equal_mm"] is not None
            ]
            if far:
                right.plot(np.median(far), error[n], mark, color=color)
                right.annotate(
                    str(n),
                    (np.median(far), error[n]),
                    xytext=(4, 4),
                    textcoords="offset points",
                    fontsize=8,
                )
    left.set(xlabel="parameters in all", ylabel="error against the truth, mm", ylim=(0, None))
    right.set(xlabel="beyond 40 mm of the pulled vertex, mm, at equal following", ylim=(0, None))
    right.set_xlim(0, None)
    left.legend()
    fig.suptitle(title)
    return fig
