"""Sums over the blocks of a Dask array, on whatever machines its scheduler has."""

REMEDY = "pip install 'facelab[scale]'"
"""What brings Dask along."""


class Killed(RuntimeError):
    """The workers that had a part died one after the other."""


def is_dask(X):
    """Whether something is a Dask array; Dask itself is not imported for it."""
    return type(X).__module__.split(".")[0] == "dask" and hasattr(X, "chunks")


def block_sums(X, work, *arguments):
    """The sum of what `work` makes of each block of frames.

    Parts are added up in a tree on the workers: only one sum comes back.

    Parameters
    ----------
    X : dask.array.Array
        Frames along the first axis; blocks are some frames of all columns.
    work : callable
        Takes a block (ndarray), its number and `arguments`; gives a list of numbers and arrays.
    *arguments
        Each worker gets them once.

    Returns
    -------
    list
        Entry by entry the sum over all blocks.

    Raises
    ------
    Killed
        If a worker was lost again and again on the same block.
    """
    from dask import delayed

    one = delayed(work)
    arguments = [delayed(a) for a in arguments]  # each one key, not a copy in every part
    blocks = [b.ravel()[0] for b in X.rechunk(dict.fromkeys(range(1, X.ndim), -1)).to_delayed()]
    parts = [one(block, i, *arguments) for i, block in enumerate(blocks)]
    while len(parts) > 1:
        parts = [delayed(_added)(parts[i : i + 4]) for i in range(0, len(parts), 4)]
    return computed(parts[0])


def _added(parts):
    total = list(parts[0])
    for part in parts[1:]:
        total = [a + b for a, b in zip(total, part, strict=True)]
    return total


def computed(*values):
    """Dask's lazy values as they are; a lost worker is told in words.

    Raises
    ------
    Killed
        If a worker was lost again and again on the same part.
    """
    import dask

    try:
        found = dask.compute(*values)
    except Exception as error:
        raise told(error) from error
    return found[0] if len(values) == 1 else found


def told(error):
    """The error, or in its place one that says what a lost worker means: exception."""
    if type(error).__name__ != "KilledWorker":
        return error
    return Killed(
        "the workers that had this part died one after the other, most likely for want of "
        "memory: give smaller blocks (fewer frames at a time), or workers with more memory."
    )
