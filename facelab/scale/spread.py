"""One piece of work for each of many items: whatever fails, the others are done."""

import time
from concurrent.futures import CancelledError

from facelab.numeric.engine import Killed, Watch, told

PATIENCE = 60.0
"""Seconds without a single worker after which what is left counts as not reached."""


class Lost(RuntimeError):
    """No worker was left that could take it, so this was not reached."""


def each(work, items, client, patience=PATIENCE):
    """Do the same to each item on the workers of a cluster.

    Parameters
    ----------
    work : callable
        Takes an item; a function of a module, which the workers can import.
    items : sequence
    client : distributed.Client
        From `cluster`.
    patience : float, default=60
        Seconds without a single worker after which the rest is given up.

    Yields
    ------
    index : int
        Of the item, in the order in which they come back.
    result : object
        What `work` made; None where it failed.
    error : Exception or None
        What `work` raised; `Killed` where the workers that had it died one after the other, at
        last each with nothing else to do; `Lost` where no worker was left that could take it.
    """
    killed = []
    for i, result, error in _rounds(work, dict(enumerate(items)), client, patience):
        if isinstance(error, Killed):  # it, or another that its worker had fetched with it
            killed.append(i)
        else:
            yield i, result, error
    for i in killed:
        yield from _rounds(work, {i: items[i]}, client, patience)


def _rounds(work, items, client, patience):
    from distributed import wait

    waiting = {client.submit(work, item, pure=False): i for i, item in items.items()}
    watch, alone_since = Watch(client), None
    why = f"no worker was left, and none came within {patience:g} s."
    try:
        while waiting:
            try:
                found = wait(list(waiting), timeout=1.0, return_when="FIRST_COMPLETED").done
            except TimeoutError:
                found = ()
                watch.look()
            except CancelledError:  # by a scheduler that went away
                found = [future for future in waiting if future.cancelled()]
            for future in found:
                try:
                    result, error = _taken(future)
                except TimeoutError:  # lost with its worker, which is made good by another
                    continue
                yield waiting.pop(future), result, error
            if _has_workers(client):
                alone_since = None
                continue
            alone_since = alone_since or time.monotonic()
            if not found and time.monotonic() - alone_since > patience:
                break
    except Killed as error:  # of the watch: there is no work to be had from these workers
        why = str(error)
    finally:
        client.cancel(list(waiting))
    for i in sorted(waiting.values()):
        yield i, None, Lost(why)


def _has_workers(client):
    try:
        return bool(client.ncores())
    except OSError:  # not even a scheduler
        return False


def _taken(future):
    if future.cancelled():
        return None, Lost("it was cancelled: the scheduler was stopped, or lost.")
    error = future.exception(timeout=10)
    if error is not None:
        return None, told(error)
    try:
        return future.result(timeout=10), None
    except TimeoutError:
        raise
    except Exception as error:  # of the work done again, where its worker died with the result
        return None, told(error)
