"""A real optical capture of a face: 41 markers of the AnimFace project."""

import os
from pathlib import Path

from facelab.checks import check_choice
from facelab.data.cache import download
from facelab.files.markers import read_markers
from facelab.keeping import cache_dir

ANIMFACE_URL = (
    "https://raw.githubusercontent.com/bigoMay/AnimFace/"
    "6b5063b8b5e7a5a10473647081b07d03b07042e7/MoCapData/"
)
MARKERS = {
    "eyebrows": (
        "EyebrowsMoCap.ma",
        "ee7b5b07b1aa9be66f33b1b6eba40e9ece6986e9dbd09ab58551f89cda39081f",
    ),
    "jaw": (
        "JawMoCap.ma",
        "add7b96f256c1d47d7e20070381edecf1004a1c6f3d40b571fbb22b077db0c77",
    ),
}
"""Takes of markers (Miguel Ramos Carretero, 2019, CC BY-SA 4.0): file and SHA-256."""

ANIMFACE_LANDMARKS = {
    "NoseHead": "nose_tip",
    "NoseTop": "nose_bridge_2",
    **{f"{s}eyebrow_Outside": f"brow_{side}_1" for s, side in (("L", "left"), ("R", "right"))},
    **{f"{s}eyebrow_M": f"brow_{side}_3" for s, side in (("L", "left"), ("R", "right"))},
    **{f"{s}eyebrow_Inside": f"brow_{side}_4" for s, side in (("L", "left"), ("R", "right"))},
    **{f"{s}eye_Up": f"eye_{side}_upper_outer" for s, side in (("L", "left"), ("R", "right"))},
    "Mouth_Up": "lip_upper",
    "Mouth_UpL1": "lip_upper_left_outer",
    "Mouth_UpR1": "lip_upper_right_outer",
    "Mouth_Lend": "mouth_corner_left",
    "Mouth_Rend": "mouth_corner_right",
    "Mouth_Down": "lip_lower",
    "Mouth_DownL": "lip_lower_left_outer",
    "Mouth_DownR": "lip_lower_right_outer",
    "Chin": "chin",
    "Chin_L1": "jaw_left_7",
    "Chin_R1": "jaw_right_7",
    "Chin_L2": "jaw_left_5",
    "Chin_R2": "jaw_right_5",
}
"""Markers that lie near a landmark, and which: within 14 mm of it on the template brought to the
markers by a similarity. Markers are glued beside brows and lips, not on them; those called Inside,
Outside and Down of the eyes sit on the rim of the orbit, 18 mm below the corners, and have none."""


def load_markers(name, root=None):
    """A take of a real optical capture: 41 named markers on a face, 60 frames a second.

    From the AnimFace project (Miguel Ramos Carretero, Efficient Facial Animation Integrating
    Euclidean and Geodesic Distance-Based Algorithms into Radial Basis Function Interpolation,
    Bournemouth University, 2019), CC BY-SA 4.0: name the author and the licence with every figure
    that shows it.

    Parameters
    ----------
    name : {"jaw", "eyebrows"}
        1,590 and 902 frames.
    root : str or Path, optional
        Folder with the files; else the environment variable `FACELAB_ANIMFACE`, the cache, or a
        download of the pinned files (4 and 2 MB).

    Returns
    -------
    MarkerSequence
        Millimetres; x to the person's left, y up, z forward, small motion of the head included.
        Names are the source's; `ANIMFACE_LANDMARKS` leads to ours, for
        `renamed`.

    Raises
    ------
    ValueError, FileNotFoundError, DataUnavailable

    Examples
    --------
    >>> import facelab
    >>> take = facelab.load_markers("jaw").renamed(facelab.data.ANIMFACE_LANDMARKS)
    >>> take, "chin" in take.names
    (MarkerSequence(1590 frames of 41 markers, 60 frames/s, 0.0 % occluded), True)
    """
    check_choice(name, "name", tuple(MARKERS))
    file, sha256 = MARKERS[name]
    folder = root or os.environ.get("FACELAB_ANIMFACE")
    if folder:
        return read_markers(Path(folder) / file)
    return read_markers(download(ANIMFACE_URL, file, sha256, cache_dir() / "animface"))
