"""Where the work goes: a Dask scheduler somewhere, or worker processes on this machine."""

import contextlib

from facelab.checks import check_count
from facelab.numeric.engine import REMEDY

WAIT = 20.0
"""Seconds until a scheduler that does not answer counts as not there."""

_LOCAL = {
    "distributed.scheduler.allowed-failures": 1,  # what kills two of them is the work, not chance
    # a worker that happens to be down so long after a death would be given up for good
    "distributed.deploy.lost-worker-timeout": "30 days",
    "distributed.worker.memory.pause": False,  # one that only waits for memory may wait for ever
    "distributed.worker.profile.enabled": False,  # looks at what runs a hundred times a second
}


@contextlib.contextmanager
def cluster(scheduler=None, workers=2, memory="auto"):
    """Context in which Dask arrays are computed, and takes spread, on a cluster: its Client.

    Parameters
    ----------
    scheduler : str, optional
        Address of a Dask scheduler, such as "tcp://10.0.0.5:8786"; it has workers of its own, in
        which facelab is installed and which see the same files.
    workers : int, default=2
        Where no scheduler is given: processes on this machine, one thread each.
    memory : int, str or None, default="auto"
        What each of those may take, such as "2GB": one that takes more is stopped and started
        anew; their share of the machine if "auto", all that there is if None.

    Raises
    ------
    RuntimeError
        If Dask is not installed.
    ConnectionError
        If no scheduler answers at the address.

    Notes
    -----
    Dask sends Python objects between its processes and obeys whoever reaches them: keep its ports
    inside a network that you trust, or give it certificates (`tls://`, see Dask's manual).
    """
    dask, distributed = _engine()
    if scheduler is not None:
        client = _reached(distributed, scheduler)
        with client:
            yield client
        return
    workers = check_count(workers, "workers", 1, None, "processes")
    with (
        dask.config.set(_LOCAL),
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, memory_limit=memory, processes=True,
            dashboard_address=None, silence_logs=50,
        ) as local,
        distributed.Client(local) as client,
    ):  # fmt: skip
        yield client


def _engine():
    try:
        import dask
        import dask.array
        import distributed
    except ImportError:
        raise RuntimeError(
            f"work on several processes or machines needs Dask, which is not installed: {REMEDY}."
        ) from None
    return dask, distributed


def _reached(distributed, address):
    try:
        return distributed.Client(address, timeout=WAIT)
    except (OSError, ValueError, TypeError, ImportError) as error:
        raise ConnectionError(
            f"no Dask scheduler answers at {address!r}; start one with `dask scheduler`, and give "
            "the address that it prints, such as tcp://10.0.0.5:8786."
        ) from error
