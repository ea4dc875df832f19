"""Light that shows form: a key, a fill and a rim light, the same in every picture of a face."""

import numpy as np

KEY, FILL, RIM = (
    np.array(d) / np.linalg.norm(d)
    for d in ([-0.45, 0.55, 0.85], [0.8, 0.1, 0.6], [0.55, 0.5, -0.75])
)
"""Directions towards the lights: right, up and towards the viewer."""
STRENGTHS = {"key": 0.62, "fill": 0.22, "rim": 0.20, "around": 0.34}


def shaded(colors, normals, gloss):
    """Colours under the three lights: shape (n, 3), 0 to 1.

    Parameters
    ----------
    colors, normals : ndarray of shape (n, 3)
        Normals of length one, in the frame of the lights (right, up, towards the viewer).
    gloss : ndarray of shape (n,)
        0 for skin, 1 for what is wet.
    """
    key, fill, rim = (np.clip(normals @ d, 0, None) for d in (KEY, FILL, RIM))
    s = STRENGTHS
    # light from all around comes a little more from above
    around = s["around"] * (1 + 0.25 * normals[:, 1])
    light = around + s["key"] * key + s["fill"] * fill + s["rim"] * rim
    between = KEY + [0, 0, 1]
    glint = np.clip(normals @ (between / np.linalg.norm(between)), 0, None)
    shine = 0.06 * (1 - gloss) * glint**12 + 0.8 * gloss * glint**150
    return np.clip(colors * light[:, None] + shine[:, None], 0, 1)
