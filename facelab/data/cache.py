"""How ready data are downloaded into the cache, unless `FACELAB_OFFLINE` forbids it."""

import os
from pathlib import Path

import pooch

from facelab.keeping import writable

_REMEDY = (
    "Without a network, copy the data to this machine and name its folder: FACELAB_ICT for a clone "
    "of ICT-FaceKit, FACELAB_CAPTURES for the recorded takes, FACELAB_ANIMFACE for the markers, "
    "FACELAB_AURA for the head Aura."
)


class DataUnavailable(RuntimeError):
    """Data that is not on this machine, and could not or must not be downloaded.

    Examples
    --------
    >>> import facelab
    >>> try:
    ...     face = facelab.load_ict_facekit().neutral
    ... except facelab.DataUnavailable:
    ...     face = facelab.load_template(4375)
    >>> "nose_tip" in face.landmarks
    True
    """


def _kept(name, sha256, folder):
    """Path of a file that was downloaded before, where downloads are forbidden."""
    kept, at_hand = folder / name, "is not at hand"
    if kept.is_file():
        if pooch.file_hash(kept) == sha256:
            return kept
        at_hand = f"is damaged in the cache ({kept})"
    raise DataUnavailable(
        f"{name} {at_hand}, and FACELAB_OFFLINE={os.environ['FACELAB_OFFLINE']} forbids a "
        f"download; unset it to allow one. {_REMEDY}"
    )


def download(url, name, sha256, folder):
    """Path of the file with this checksum: the one in the folder, else a download put there.

    Raises
    ------
    DataUnavailable
        If it is not in the folder and cannot be downloaded, or the environment variable
        `FACELAB_OFFLINE` (any value but 0) forbids that.
    ValueError
        If what was downloaded is another file.
    """
    if os.environ.get("FACELAB_OFFLINE", "0") not in ("", "0"):
        return _kept(name, sha256, folder)
    if not (folder / name).is_file():
        folder = writable(folder)
    try:
        return Path(
            pooch.retrieve(
                url + name,
                known_hash=f"sha256:{sha256}",
                fname=name,
                path=folder,
                progressbar=False,
            )
        )
    except ValueError as error:  # not a matter of the network: what came is not what was pinned
        raise ValueError(
            f"{name} was downloaded, but is not the file it should be: {error} Try again. {_REMEDY}"
        ) from None
    except Exception as error:  # no network, a server's refusal
        raise DataUnavailable(
            f"{name} is not at hand and could not be downloaded ({type(error).__name__}). {_REMEDY}"
        ) from None
