"""Recorded performances."""

import os
from pathlib import Path

from facelab.checks import check_choice
from facelab.data.cache import download
from facelab.files.takes import read_live_link_csv
from facelab.keeping import cache_dir

TAKES_URL = (
    "https://raw.githubusercontent.com/alexdjulin/LiveLinkFace-CSV-Retarget-For-Motionbuilder/"
    "122e2b234116f74bf3587c34120698f4a4def9d8/anim/"
)


TAKES = {
    "alex_rom_3": "424bf902b436ee7bcb6dc5ef722e13348cd995e7f6d2e510abdebedfcf1b74f6",
    "alex_rom_4": "985a5699f1384e41155480b32353d53a8851c9dc7598acf3c26187a8dadfb317",
}
"""Recorded performances (one performer, two takes, MIT licence) and their SHA-256."""


def load_take(name, root=None):
    """A recorded performance: 52 ARKit weights in each frame.

    Parameters
    ----------
    name : str
        One of `TAKES`.
    root : str or Path, optional
        Folder with the CSV files; else the environment variable `FACELAB_CAPTURES`, the cache,
        or a download.

    Returns
    -------
    WeightSequence

    Raises
    ------
    ValueError, FileNotFoundError, DataUnavailable

    Examples
    --------
    >>> import facelab
    >>> len(facelab.load_take("alex_rom_3").names)
    52
    """
    check_choice(name, "name", tuple(TAKES))
    folder = root or os.environ.get("FACELAB_CAPTURES")
    if folder:
        return read_live_link_csv(Path(folder) / f"{name}.csv")
    return read_live_link_csv(
        download(TAKES_URL, f"{name}.csv", TAKES[name], cache_dir() / "captures")
    )
