"""Sums over the blocks of a Dask array, on whatever machines its scheduler has."""

import sys
import time

STUCK = 10.0
"""Seconds after which a worker that waits for memory, and does nothing, is started anew."""
OFTEN = 3
"""How often that is done before it is given up."""

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
        If a block needs more memory than a worker may take.
    """
    from dask import delayed

    one = delayed(work)
    arguments = [delayed(a) for a in arguments]  # each one key, not a copy in every part
    blocks = [b.ravel()[0] for b in X.rechunk(dict.fromkeys(range(1, X.ndim), -1)).to_delayed()]
    parts = [one(block, i, *arguments) for i, block in enumerate(blocks)]
    while len(parts) > 1:
        parts = [delayed(_added)(parts[i : i + 4]) for i in range(0, len(parts), 4)]
    try:
        return _computed(parts[0])
    except (Killed, MemoryError) as error:
        raise Killed(_too_large(X)) from error


def _too_large(X):
    """What is to be done about blocks that no worker has room for."""
    rows, width = max(X.chunks[0]), X[:1].size
    size = rows * width * X.dtype.itemsize / 1e6
    return (
        f"learning needs more memory than a worker may take: a block (chunk) has {rows} frames of "
        f"{width} numbers, {size:.0f} MB, and a worker needs some times that. Give smaller blocks "
        f"(chunks of {max(1, rows // 4)} frames, made so where they are read; of takes, fewer "
        "vertices: `samples` of `frames_of`), or workers with more memory (`memory` of `cluster`)."
    )


def _added(parts):
    total = list(parts[0])
    for part in parts[1:]:
        total = [a + b for a, b in zip(total, part, strict=True)]
    return total


def _computed(value):
    """One of Dask's lazy values as it is."""
    client = _client()
    if client is None:  # threads of this process
        return value.compute()
    from distributed import wait

    future, watch = client.compute(value), Watch(client)
    try:
        while not future.done():
            try:
                wait(future, timeout=1.0)
            except TimeoutError:
                watch.look()
        return future.result()
    except Exception as error:
        raise told(error) from error
    finally:
        future.cancel()


def _client():
    """The client that computes Dask's values now, if any."""
    distributed = sys.modules.get("distributed")
    try:
        return distributed and distributed.default_client()
    except ValueError:
        return None


class Watch:
    """Starts workers anew that wait for memory which nothing will free.

    A worker with four fifths of its memory taken takes no more work until some is free. Where what
    takes it is no result that could go elsewhere, that is for ever.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client):
        self.client, self.looked, self.since, self.times = client, time.monotonic(), {}, 0

    def look(self):
        """Call it while nothing comes back; it asks now and then.

        Raises
        ------
        Killed
            If workers run out of memory again and again.
        """
        now = time.monotonic()
        if now - self.looked < STUCK / 2:
            return
        self.looked = now
        try:
            workers = self.client.scheduler_info()["workers"]
        except OSError:  # no scheduler: whoever waits learns of it
            return
        idle = [address for address, worker in workers.items() if _waits(worker)]
        self.since = {address: self.since.get(address, now) for address in idle}
        long = [address for address in idle if now - self.since[address] >= STUCK]
        if not long:
            return
        if len(idle) < len(workers) and not any(self.client.processing(long).values()):
            return  # others are at work, and none waits for these
        self.times += 1
        if self.times > OFTEN:
            raise Killed(_SHORT)
        self.client.restart_workers(long, raise_for_error=False)


def _waits(worker):
    counts = worker.get("metrics", {}).get("task_counts", {})
    return worker.get("status") == "paused" and not counts.get("executing")


_SHORT = (
    "the workers that had this died one after the other, or stood still, most likely for want of "
    "memory: give less at a time (shorter takes, smaller meshes), or fewer workers with more "
    "memory each."
)


def told(error):
    """The error, or in its place one that says what a lost worker means: exception."""
    return Killed(_SHORT) if type(error).__name__ == "KilledWorker" else error
