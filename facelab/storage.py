"""Files written whole or not at all, and our own npz files."""

import os
import tempfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np


@contextmanager
def atomic_path(path):
    """A temporary path beside `path` that takes its place when all went well, else vanishes."""
    path = _as_path(path)
    if not path.parent.is_dir():
        raise FileNotFoundError(f"path={str(path)!r}: the folder {path.parent} does not exist.")
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    try:
        yield Path(name)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _as_path(path):
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path is a {type(path).__name__}; give a str or a Path.")
    return Path(path)


def existing_file(path, what):
    """The path as a `Path`, refused unless it is a file with something in it.

    Parameters
    ----------
    path : str or Path
    what : str
        What the file should be, for the message ("OBJ file").

    Raises
    ------
    FileNotFoundError, ValueError, TypeError
        For a missing file, a folder or an empty file, or what is no path.
    """
    path = _as_path(path)
    if not path.exists():
        raise FileNotFoundError(f"path={str(path)!r}: there is no such {what}.")
    if not path.is_file():
        raise ValueError(f"path={str(path)!r} is not a file; give the path of one {what}.")
    if path.stat().st_size == 0:
        raise ValueError(f"path={str(path)!r} is empty; export the {what} again.")
    return path


def save_npz(path, kind, version, **arrays):
    """Write named arrays to one compressed file, whole or not at all.

    Parameters
    ----------
    path : str or Path
        Ends in .npz.
    kind : str
        What the file holds; `load_npz` refuses files of another kind.
    version : int
        Layout of that kind; raise it when the arrays change.
    **arrays : array_like
        Numbers or strings; Python objects are refused, for they would need pickle.
    """
    if Path(path).suffix != ".npz":
        raise ValueError(f"path={str(path)!r} must end in .npz.")
    arrays = {name: np.asarray(a) for name, a in arrays.items()}
    objects = [name for name, a in arrays.items() if a.dtype.hasobject]
    if objects:
        raise TypeError(
            f"{', '.join(objects)}: Python objects cannot be stored; give plain arrays."
        )
    with atomic_path(path) as part, open(part, "wb") as out:
        np.savez_compressed(out, facelab_kind=kind, facelab_version=version, **arrays)


def load_npz(path, kind, version):
    """Arrays of a file written by `save_npz`, as a dict; never unpickles anything.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is missing, damaged, of another kind or of another version.
    """
    path = existing_file(path, "npz file")
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        found = str(arrays.pop("facelab_kind")), int(arrays.pop("facelab_version"))
    except Exception as error:  # zip, header and pickle refusals each raise their own
        raise ValueError(f"{path}: not a readable facelab npz file ({error}).") from error
    if found != (kind, version):
        raise ValueError(
            f"{path} holds {found[0]!r} of version {found[1]}, but {kind!r} of version {version} "
            "is wanted; make the file again with this version of facelab."
        )
    return arrays
