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
    """Path of a file in the cache, fetched once and held against its checksum.

    Raises
    ------
    DataUnavailable
        Without a network, and where `FACELAB_OFFLINE` is set and the cache does not have the file.
    ValueError
        If what came is not what was pinned.
    """
    remedy = (
        "copy the data to this machine and name its folder: FACELAB_ICT for a clone of "
        "ICT-FaceKit, FACELAB_CAPTURES for the recorded takes, FACELAB_ANIMFACE for the markers."
    )
    if os.environ.get("FACELAB_OFFLINE"):
        kept = folder / name
        if kept.is_file() and pooch.file_hash(str(kept)) == sha256:
            return kept
        raise DataUnavailable(
            f"{name} is not at hand, and FACELAB_OFFLINE forbids to download it: {remedy}"
        )
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
            f"does not help, {remedy}"
        ) from None
    except Exception as error:  # no network, a server's refusal
        raise DataUnavailable(
            f"{name} is not at hand and could not be downloaded ({type(error).__name__}). Without "
            f"a network, {remedy}"
        ) from None
