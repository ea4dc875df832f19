"""Captures as whole folders, and the cache of them."""

from pathlib import Path

import numpy as np

from data_synth.action_units import actor_rig
from data_synth.actors import ACTORS
from data_synth.capture.reading import Capture
from data_synth.capture.recording import SIZES, VERSION, record
from facelab.checks import check_choice
from facelab.keeping import build, keep, source_stamp


def make_capture(actor, folder, size="default", random_state=0, rig=None, progress=True):
    """Make the capture of one actor, whole or not at all.

    Parameters
    ----------
    actor : str
        One of `data_synth.actors.ACTORS`.
    folder : str or Path
        Made under another name first, renamed when whole. Must not exist yet, or be empty.
    size : {"default", "small"}
    random_state : int, default=0
        All that happens follows from it; the actors' faces and manners do not change.
    rig : ActionUnitRig, optional
        The actor's face, or another with its `names`, `neutral` and `animate`; built if left out.
    progress : bool, default=True
        Show a progress bar.

    Returns
    -------
    Capture

    Raises
    ------
    ValueError, TypeError
        For an unknown actor or size, or a seed that is no integer of 0 or more.
    OSError
        If the folder holds something already or cannot be written, or the disk is full.
    """
    key = _key(actor, size, random_state)
    build(Path(folder), key, _recorder(key, rig, progress))
    return Capture(folder, rig, check=False)


def open_capture(actor, root, size="default", random_state=0, progress=True, spare=False):
    """The capture of one actor from a cache, made on first use.

    Parameters
    ----------
    actor : str
    root : str or Path
        The cache. The capture stands in `data_synth-<size>-<random_state>/<actor>`; one that is
        incomplete, damaged, or made by other code is made again.
    size : {"default", "small"}
    random_state : int, default=0
    progress : bool, default=True
    spare : bool, default=False
        Where the cache cannot be written, use a temporary folder, and warn.

    Returns
    -------
    Capture

    Raises
    ------
    ValueError, TypeError
        As `make_capture`.
    OSError
        If the cache cannot be written, or the disk is full.
    """
    key = _key(actor, size, random_state)
    folder = Path(root) / f"data_synth-{size}-{random_state}" / actor
    make = _recorder(key, None, progress)
    return keep(folder, key, make, lambda whole: Capture(whole, check=False), spare)


def _key(actor, size, random_state):
    """What a capture follows from."""
    check_choice(actor, "actor", tuple(ACTORS))
    check_choice(size, "size", tuple(SIZES))
    if isinstance(random_state, bool) or not isinstance(random_state, (int, np.integer)):
        raise TypeError(f"random_state={random_state!r} is not an integer.")
    if random_state < 0:
        raise ValueError(f"random_state={random_state}, but it must be 0 or more.")
    return {
        "version": VERSION, "code": source_stamp(__package__), "actor": actor, "size": size,
        "random_state": int(random_state),
    }  # fmt: skip


def _recorder(key, rig, progress):
    """A function that records a capture into a folder."""
    actor, size = key["actor"], key["size"]

    def make(folder):
        face = actor_rig(actor, SIZES[size].n_vertices) if rig is None else rig
        record(folder, actor, size, key["random_state"], face, progress)

    return make
