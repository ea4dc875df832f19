"""The size of a face: how a length in another unit is noticed."""

import warnings

import numpy as np

INCH = 25.4
FACE_MM = 220.0  # longest side of a box round a face; a mask has 130, a head with neck 400
_UNITS = {
    0.1: "tenths of a millimetre",
    1.0: "millimetres",
    10.0: "centimetres",
    25.4: "inches",
    100.0: "decimetres",
    1000.0: "metres",
}


def longest_side(vertices):
    """Longest side of the box round some vertices, in their own unit."""
    return float(np.ptp(np.asarray(vertices, dtype=float), axis=0).max())


def face_scale(side):
    """Millimetres in the unit that makes a length the longest side of a face.

    Parameters
    ----------
    side : float
        As `longest_side` gives it. A face has 70 to 700 mm.

    Returns
    -------
    scale : float or None
        1 for millimetres, 10 for centimetres, 100, 1000, or 0.1; None if no unit fits.

    Examples
    --------
    >>> face_scale(0.21)
    1000.0
    """
    scale = 10.0 ** round(np.log10(FACE_MM / side)) if side > 0 else None
    return scale if scale in _UNITS else None


def mesh_scale(side, whole=True):
    """As `face_scale`, of a mesh: inches where tens make no whole face.

    Parameters
    ----------
    side : float
    whole : bool, default=True
        It is no part of a face.

    Returns
    -------
    scale : float or None
    said : str
        The unit that it stands for, and the other one that it may be.

    Examples
    --------
    >>> mesh_scale(7.05)
    (25.4, 'inches (or centimetres: 10)')
    """
    tens, inches = face_scale(side), INCH * side
    found = INCH if whole and 110 <= inches < 254 else tens
    said, other = _UNITS.get(found, ""), INCH if found == tens else tens
    if other and 100 <= inches <= 700:
        said += f" (or {_UNITS[other]}: {other:g})"
    return found, said


def check_face_size(vertices, name, scale=None, part=False):
    """Warn of a face whose size is no face's.

    Parameters
    ----------
    vertices : array_like of shape (n_vertices, 3)
        Of a face or a head: millimetres, or in the unit of its file if `scale` is given.
    name : str
        What it is, for the message ("rig", "head.obj").
    scale : float, optional
        Millimetres that a reader takes the file's unit for; the remedy is then another one.
    part : bool, default=False
        It may be a part of a face, as small as an eye.

    Returns
    -------
    fits : bool

    Warns
    -----
    UserWarning
        With the factor that would make it a face's size, if there is one.
    """
    side = longest_side(vertices)
    found, unit = mesh_scale(side, whole=not part)
    used = 1.0 if scale is None else scale
    # a scale that was given need not be a power of ten
    if face_scale(side * used) == 1 or (part and face_scale(side * used * 10) == 1):
        return True
    said = f"{name}: its longest side is {side * used:.4g} mm, and a face's is 70 to 700"
    if found is None:
        said += "; no unit of length makes it a face"
    else:
        body = ", or a whole body" if face_scale(side * used) == 0.1 else ""
        said += f"; it looks like {unit}{body}: "
        said += f"multiply its lengths by {found:g}" if scale is None else f"give scale={found:g}"
    warnings.warn(f"{said}.", stacklevel=3)
    return False
