"""The size of a face: how a length in another unit is noticed."""

import warnings

import numpy as np

FACE_MM = 220.0  # longest side of a box round a face; a mask has 130, a head with neck 400
_UNITS = {
    0.1: "tenths of a millimetre",
    10.0: "centimetres",
    100.0: "decimetres",
    1000.0: "metres",
}


def face_scale(vertices):
    """The power of ten that brings a face to millimetres: 1 if it is in them, None if none does.

    Parameters
    ----------
    vertices : array_like of shape (n_vertices, 3)
        Of a face or a head. Its longest side counts: 70 to 700 mm is a face's.

    Examples
    --------
    >>> face_scale([[0, 0, 0], [0.14, 0.21, 0.1]])  # metres
    1000.0
    """
    side = float(np.ptp(np.asarray(vertices, dtype=float), axis=0).max())
    scale = 10.0 ** round(np.log10(FACE_MM / side)) if side > 0 else None
    return scale if scale == 1 or scale in _UNITS else None


def check_face_size(vertices, name, remedy="multiply its lengths by {scale:g}", part=False):
    """Warn of a face whose size is no face's in millimetres.

    Parameters
    ----------
    vertices : array_like of shape (n_vertices, 3)
    name : str
        What it is, for the message ("rig", "head.obj").
    remedy : str
        What to do, with `{scale:g}` for the factor.
    part : bool, default=False
        It may be a part of a face, as small as an eye.

    Returns
    -------
    scale : float or None
        As `face_scale` gives it; nothing is changed.

    Warns
    -----
    UserWarning
        With the factor, if there is one.
    """
    scale = face_scale(vertices)
    if scale == 1 or (part and scale == 10):
        return 1.0
    side = float(np.ptp(np.asarray(vertices, dtype=float), axis=0).max())
    said = f"{name}: its longest side is {side:.4g} mm, and a face's is 70 to 700"
    if scale is None:
        said += "; no unit of length makes it a face. Is it one?"
    else:
        body = ", or a whole body" if scale == 0.1 else ""
        said += f"; it looks like {_UNITS[scale]}{body}: {remedy.format(scale=scale)}."
    warnings.warn(said, stacklevel=3)
    return scale
