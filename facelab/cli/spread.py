"""The jobs of a command on the workers of a cluster."""

import functools
import os
import platform

from facelab.cli.batch import Outcome, UsageError, attempt
from facelab.cli.terminal import complain
from facelab.scale import Lost, cluster, each


def on_workers(argv, options):
    """What `batch.run` takes as `doing`: jobs go to workers, and come back as they are done.

    Parameters
    ----------
    argv : list of str
        The command line, from which each worker makes its own tools once.
    options : argparse.Namespace
        `scheduler` and `workers`.
    """
    if options.scheduler is not None and options.workers is not None:
        raise UsageError("--scheduler has workers of its own: leave --workers out.")
    if options.workers is not None and options.workers < 1:
        raise UsageError(f"--workers {options.workers}: give 1 or more.")

    def doing(jobs):
        if not jobs:
            return
        work, lost = functools.partial(_work, tuple(argv), os.getcwd()), None
        with cluster(options.scheduler, options.workers or 2) as client:
            for i, outcome, error in each(work, jobs, client):
                if isinstance(error, Lost):
                    if lost is None:  # said once: it is the same for all that are left
                        complain(f"not reached: {error}")
                    outcome, lost = None, error
                elif error is not None:
                    outcome = Outcome({}, str(error), [], 0.0)
                yield jobs[i], outcome

    return doing


def _work(argv, folder, job):
    """One job, on a worker: Outcome."""
    try:
        os.chdir(folder)
    except OSError:
        raise RuntimeError(
            f"the worker on {platform.node()} does not see the folder {folder}; workers need "
            "the same files in the same place."
        ) from None
    return attempt(job, _maker(argv))


@functools.lru_cache(maxsize=1)
def _maker(argv):
    from facelab.cli.main import maker_of  # the parser knows all commands, this one too

    return maker_of(list(argv))
