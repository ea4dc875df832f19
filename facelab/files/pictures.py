"""Pictures that a file of a mesh names: read safely, or refused with a reason."""

import io
import warnings

import numpy as np
from PIL import Image

from facelab.storage import existing_file

_MOST = 8192  # pixels along a side of a picture that is opened
_KEPT = 2048  # and of what is kept of it
MOST_BYTES = 64 << 20
_MODES = ("1", "L", "LA", "P", "RGB", "RGBA", "CMYK")


def bytes_beside(path, name, at, most=None):
    """What a file holds (`most` bytes at most) that another names, from its folder or those in it.

    Parameters
    ----------
    path : Path
        The file that names it.
    name : str
        As it does.
    at : str
        Where, for the message.

    Raises
    ------
    FileNotFoundError, ValueError
    """
    folder = path.parent.resolve()
    other = None if "\0" in name or ":" in name else (folder / name).resolve()
    if other is None or not other.is_relative_to(folder):
        raise ValueError(
            f"{path}: {at} is {name[:80]!r}; data are only read from the folder of the file and "
            "those in it. Put the file there."
        )
    other = existing_file(other, f"file of data ({at} of {path})")
    if most is not None and other.stat().st_size > most:
        raise ValueError(
            f"{path}: {at} names a file of {other.stat().st_size / 1e6:,.0f} MB, but "
            f"{most / 1e6:,.0f} MB is the most that is read; make it smaller."
        )
    return other.read_bytes()


def picture(stored, where):
    """The picture in some bytes, shape (height, width, 3), uint8, at most 2048 pixels wide or high.

    Parameters
    ----------
    stored : bytes
        Of a PNG or JPEG.
    where : str
        File and place, for the message.

    Raises
    ------
    ValueError
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            opened = Image.open(io.BytesIO(stored), formats=("PNG", "JPEG"))
            width, height = opened.size
            if max(width, height) <= _MOST and opened.mode in _MODES:
                opened.draft("RGB", (_KEPT, _KEPT))
                opened.load()
    except Image.DecompressionBombError:
        raise ValueError(
            f"{where} has more pixels than {_MOST} x {_MOST}; make it smaller."
        ) from None
    except Exception:  # Pillow has no one kind of its own
        raise ValueError(f"{where} is no sound PNG or JPEG; export the file again.") from None
    if max(width, height) > _MOST:
        raise ValueError(
            f"{where} has {width} x {height} pixels, but {_MOST} x {_MOST} is the most that is "
            "opened; make it smaller."
        )
    if opened.mode not in _MODES:
        raise ValueError(f"{where} has 16 bits for a colour; save it with 8.")
    opened = opened.convert("RGB")
    opened.thumbnail((_KEPT, _KEPT))
    return np.asarray(opened)


def most_seen(path, on):
    """The picture that is on most triangles, of how many each is on; the others are said."""
    if len(on) > 1:
        warnings.warn(
            f"{path}: the mesh has {len(on)} pictures of base colour; the one on most triangles is "
            "kept, the others are left out.",
            stacklevel=5,
        )
    return max(on, key=on.get)


def or_left_out(texture_of, *about):
    """The texture that a function makes; None, with a warning, where it cannot be read.

    The mesh is read without.
    """
    try:
        return texture_of(*about)
    except (ValueError, FileNotFoundError) as error:  # ours, with file and place
        warnings.warn(f"{error} The texture is left out.", stacklevel=4)
        return None
