"""What a study found, kept in the cache: computed once for the same data, settings and code."""

import hashlib

import numpy as np

from facelab.keeping import keep_arrays, source_stamp


def kept(study, of, make):
    """What a study found, from the cache or computed and kept there: dict of str to ndarray.

    Parameters
    ----------
    study : str
        Its module in `facelab.studies` and a name, such as "reliability.all".
    of : iterable
        All that the result hangs on beside the code: arrays, and what tells itself by its `repr`.
    make : callable
        Gives the arrays: dict of str to array_like.

    Examples
    --------
    >>> found = kept("kept.doubled", [np.arange(3)], lambda: {"twice": 2 * np.arange(3)})
    >>> found["twice"].tolist()
    [0, 2, 4]
    """
    digest = hashlib.sha256()
    for part in of:
        if isinstance(part, np.ndarray):
            digest.update(repr((part.shape, part.dtype.str)).encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        else:
            digest.update(repr(part).encode())
    key = {"of": digest.hexdigest(), "code": source_stamp(f"{__package__}.{study.split('.')[0]}")}
    return keep_arrays(f"studies/{study}-{key['of'][:16]}", key, make)
