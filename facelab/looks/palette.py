"""Colours that are told apart, also by the colour-blind, and which region of a map gets which."""

import numpy as np
from matplotlib.colors import to_rgb

VISIONS = {  # what a colour looks like, as a matrix of linear red, green, blue
    "normal": np.eye(3),
    "protan": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
         [-0.003882, -0.048116, 1.051998]]
    ),
    "deutan": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
         [-0.011820, 0.042940, 0.968881]]
    ),
    "tritan": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
         [0.004733, 0.691367, 0.303900]]
    ),
}  # fmt: skip
"""Normal vision and the three dichromacies, Machado, Oliveira and Fernandes 2009, severity 1."""

_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
     [0.0193339, 0.1191920, 0.9503041]]
)  # fmt: skip
TOUCHING = 15.0
"""Aimed at between regions that touch, in CIEDE2000, for every vision."""


def lab(colors, vision="normal"):
    """CIE L*a*b* (D65) of sRGB colours, as a vision sees them: shape (n, 3).

    Parameters
    ----------
    colors : ndarray of shape (n, 3)
        0 to 1.
    vision : str
        One of `VISIONS`.
    """
    c = np.asarray(colors, dtype=float)
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ VISIONS[vision].T, 0, 1) @ _TO_XYZ.T / _TO_XYZ.sum(axis=1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = f.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def ciede2000(a, b):
    """Difference of colours in L*a*b*, shapes (..., 3): shape (...).

    References
    ----------
    Sharma, Wu and Dalal, The CIEDE2000 color-difference formula, 2005.

    Examples
    --------
    >>> round(float(ciede2000(np.array([50, 2.5, 0]), np.array([50, 0, -2.5]))), 4)
    4.3065
    """
    (L1, a1, b1), (L2, a2, b2) = (np.moveaxis(np.asarray(x, dtype=float), -1, 0) for x in (a, b))
    mean = ((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2) ** 7
    G = 0.5 * (1 - np.sqrt(mean / (mean + 25.0**7)))
    a1, a2 = (1 + G) * a1, (1 + G) * a2
    C1, C2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(y, x)) % 360 for y, x in ((b1, a1), (b2, a2)))
    grey = C1 * C2 == 0
    turn = np.where(grey, 0.0, (h2 - h1 + 180) % 360 - 180)
    turn = np.where(~grey & (np.abs(h2 - h1) == 180), h2 - h1, turn)
    far = np.abs(h1 - h2) > 180
    h = np.where(
        grey, h1 + h2, (h1 + h2 + np.where(far, np.where(h1 + h2 < 360, 360, -360), 0)) / 2
    )
    dL, dC = L2 - L1, C2 - C1
    dH = 2 * np.sqrt(C1 * C2) * np.sin(np.radians(turn / 2))
    L, C = (L1 + L2) / 2, (C1 + C2) / 2
    waves = zip((-0.17, 0.24, 0.32, -0.20), (1, 2, 3, 4), (-30, 0, 6, -63), strict=True)
    T = 1 + sum(k * np.cos(np.radians(n * h + shift)) for k, n, shift in waves)
    SL = 1 + 0.015 * (L - 50) ** 2 / np.sqrt(20 + (L - 50) ** 2)
    SC, SH = 1 + 0.045 * C, 1 + 0.015 * C * T
    R = -2 * np.sqrt(C**7 / (C**7 + 25.0**7))
    R = R * np.sin(np.radians(60 * np.exp(-(((h - 275) / 25) ** 2))))
    light, chroma, hue = dL / SL, dC / SC, dH / SH
    return np.sqrt(light**2 + chroma**2 + hue**2 + R * chroma * hue)


def differences(colors):
    """The least difference of each two colours over all visions: shape (n, n)."""
    seen = [lab(colors, vision) for vision in VISIONS]
    return np.min([ciede2000(x[:, None], x[None]) for x in seen], axis=0)


PALETTE = (  # farthest first: no two nearer than 10.7 in any vision (found by farthest points)
    *("#623b9d", "#b1ffb1", "#ebb1ff", "#b11427", "#769d89", "#89769d", "#b19d14", "#893b4e"),
    *("#9dc4c4", "#b189ff", "#b1b176", "#7662c4", "#b16200", "#627676", "#3b6276", "#d8ebff"),
    *("#ffeb62", "#9d7662", "#62d8b1", "#9d9dc4"),
)
_LEAST = 8  # so many colours are there to choose from for a map of few regions
_TRIES = 24


def map_colors(touch, fixed=None):
    """A colour of `PALETTE` for each region, those that touch well apart: indices, shape (n,).

    Up to 20 regions have a colour of their own. Places are exchanged, from several starts, until
    no exchange brings regions that touch farther apart.

    Parameters
    ----------
    touch : ndarray of bool, shape (n, n)
        Which regions touch.
    fixed : ndarray of int, shape (n,), optional
        Colours that are kept; -1 for those to be chosen.

    Examples
    --------
    >>> map_colors(np.array([[False, True], [True, False]])).tolist()
    [0, 1]
    """
    n, all_colors = len(touch), np.array([to_rgb(c) for c in PALETTE])
    apart = differences(all_colors)
    fixed = np.full(n, -1) if fixed is None else np.asarray(fixed)
    free = np.flatnonzero(fixed < 0)
    unused = [c for c in range(len(PALETTE)) if c not in fixed]
    if n <= _LEAST:
        unused = unused[: max(len(free), _LEAST - (n - len(free)))]
    while len(unused) < len(free):  # more regions than colours
        unused += list(range(len(PALETTE)))
    a, b = np.nonzero(np.triu(touch, 1))
    rng = np.random.default_rng(0)
    best = np.inf, None
    for attempt in range(_TRIES if len(free) > 1 else 1):
        hand = np.array(unused) if attempt == 0 else rng.permutation(unused)
        cost, chosen = _exchanged(hand, free, fixed, apart, a, b)
        if cost < best[0]:
            best = cost, chosen
        if cost == 0:
            break
    return best[1]


def _exchanged(hand, free, fixed, apart, a, b):
    """Hand out colours and exchange two while that helps: what is missing, and the colours."""
    chosen = fixed.copy()

    def cost(hand):
        chosen[free] = hand[: len(free)]
        return np.square(np.clip(TOUCHING - apart[chosen[a], chosen[b]], 0, None)).sum()

    least, better = cost(hand), True
    while better and least > 0:
        better = False
        for i in range(len(free)):
            for j in range(i + 1, len(hand)):
                hand[[i, j]] = hand[[j, i]]
                now = cost(hand)
                if now < least:
                    least, better = now, True
                else:
                    hand[[i, j]] = hand[[j, i]]
    cost(hand)
    return least, chosen.copy()
