"""Where ready data are kept, and how they are downloaded."""

import os
from pathlib import Path

import pooch

CACHE_VERSION = 1


class DataUnavailable(RuntimeError):
    """Data that is not on this machine and could not be downloaded.

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


def cache_dir():
    """Folder for downloaded and made data: `FACELAB_CACHE`, else the user's cache folder."""
    folder = Path(os.environ.get("FACELAB_CACHE") or pooch.os_cache("facelab"))
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def download(url, name, sha256, folder):
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
            f"{name} was downloaded, but is not the file it should be: {error} Try again; if that "
            "does not help, copy the data to this machine and name its folder in FACELAB_ICT or "
            "FACELAB_CAPTURES."
        ) from None
    except Exception as error:  # no network, a server's refusal
        raise DataUnavailable(
            f"{name} is not at hand and could not be downloaded ({type(error).__name__}). "
            "Without a network, copy the data to this machine and name its folder: FACELAB_ICT for "
            "a clone of ICT-FaceKit, FACELAB_CAPTURES for the recorded takes."
        ) from None
