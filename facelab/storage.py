"""Files written whole or not at all, and our own npz files, read with care."""

import codecs
import contextlib
import errno
import math
import os
import secrets
import shutil
import time
import zipfile
from pathlib import Path

import numpy as np

_PART = ".facelab-"  # how the names of unfinished files begin
_LEFT_OVER = 3600.0  # seconds after which an unfinished file has lost its writer

WAITS = (0.05, 0.1, 0.2, 0.4, 0.8) if os.name == "nt" else ()
"""Seconds between attempts to replace a file: most programs look at one and close it."""

_KINDS = "biufU"  # booleans, integers, floats, text
_SQUEEZED = 1100  # deflate makes a thousandth of zeros, never less
_SMALL = 2**28  # bytes that any file may take in memory
_GROWTH = 100  # beyond that, how often its size a file of measured numbers may take

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_SHUT = {errno.EACCES, errno.EPERM, errno.EROFS}


# --- writing --------------------------------------------------------------------------------------


@contextlib.contextmanager
def atomic_path(path):
    """A temporary path beside `path` that takes its place when all went well, else vanishes.

    The file keeps the mode of the one it replaces, and a symbolic link stays one: what it points
    to is replaced. Temporary files that killed writers left in the folder an hour ago or more are
    removed.

    Raises
    ------
    FileNotFoundError, PermissionError, ValueError, TypeError
        At once, as `check_writable`.
    OSError
        If the disk is full; the file that was there stands.
    """
    target = _target(path)
    part = _claimed(target, path)
    try:
        _sweep(target.parent, part)
        yield part
        if target.exists():
            shutil.copymode(target, part)
        with open(part, "rb+") as written:
            os.fsync(written.fileno())  # a name must not outlive its content
        _replace(part, target, path)
    except BaseException as error:
        part.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno in _FULL:
            raise _full(error.errno, path) from error
        raise


def _replace(part, target, path):
    """Put a file in the place of another, which Windows refuses while a program has that open."""
    for wait in (*WAITS, None):
        try:
            return os.replace(part, target)
        except PermissionError as error:
            if wait is None:
                raise PermissionError(
                    f"path={str(path)!r}: the file that is there cannot be replaced; close it "
                    "where it is open, allow replacing it, or choose another name."
                ) from error
            time.sleep(wait)
        except OSError as error:
            if error.errno == errno.EINVAL:  # a name that only Windows has none for: a:b, con
                raise _no_path(Path(path), error) from error
            raise


def check_writable(path):
    """Refuse a path that no file can be written to, before the work that makes the file.

    Raises
    ------
    FileNotFoundError
        If the folder does not exist.
    PermissionError
        If the folder, or the file that is there, is write-protected.
    ValueError, TypeError
        If the name is too long for the file system, if a folder or something else that is no file
        has it, or if it is no path.
    """
    _claimed(_target(path), path).unlink()


def _target(path):
    """What a path stands for, symbolic links followed; refused if that can be no file."""
    path = _as_path(path)
    try:
        path.lstat()
        target = path.resolve() if path.is_symlink() else path
    except (FileNotFoundError, NotADirectoryError):
        target = path  # a new file
    except (OSError, RuntimeError, ValueError) as error:
        raise _no_path(path, error) from error
    if not target.parent.is_dir():
        kind = "is not a folder" if target.parent.exists() else "does not exist"
        raise FileNotFoundError(f"path={str(path)!r}: the folder {target.parent} {kind}.")
    if target.exists():
        if not target.is_file():
            kind = "a folder; add the name of a file" if target.is_dir() else "not a file"
            raise ValueError(f"path={str(path)!r} is {kind}.")
        if not os.access(target, os.W_OK):
            raise PermissionError(
                f"path={str(path)!r}: the file that is there is write-protected; choose another "
                "name, or allow writing."
            )
    return target


def _claimed(target, path):
    """An empty file beside the target, with the mode that new files have."""
    suffix = target.suffix if len(target.suffix) < 16 else ""
    part = target.with_name(f"{_PART}{secrets.token_hex(6)}{suffix}")
    try:
        os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        if error.errno in _FULL:
            raise _full(error.errno, path) from error
        raise PermissionError(
            f"path={str(path)!r}: the folder {target.parent} cannot be written to; choose another, "
            "or allow writing."
        ) from error
    return part


def _sweep(folder, own):
    """Remove what killed writers left unfinished, so long ago that none is at work on it."""
    for part in folder.glob(f"{_PART}*"):
        with contextlib.suppress(OSError):  # another process may sweep as well
            if part != own and time.time() - part.stat().st_mtime > _LEFT_OVER:
                part.unlink()


def _full(number, path):
    return OSError(
        number,
        f"path={str(path)!r}: the disk is full; free some space, or choose another folder. A file "
        "that was there stands unchanged",
    )


def _no_path(path, error):
    """What is wrong with a path that cannot even be looked at."""
    number = getattr(error, "errno", None)
    shown = str(path) if len(str(path)) < 80 else f"{str(path)[:60]}..."
    if number == errno.ENAMETOOLONG:
        size = len(os.fsencode(path.name))
        return ValueError(
            f"path={shown!r}: its name of {size} bytes is too long for the file system; choose a "
            "shorter one."
        )
    if number in _SHUT:
        return PermissionError(
            f"path={shown!r}: the folder {path.parent} may not be opened; choose another, or allow "
            "it."
        )
    if number == errno.ELOOP or isinstance(error, RuntimeError):
        return ValueError(f"path={shown!r} is a symbolic link that leads back to itself.")
    return ValueError(f"path={shown!r} cannot be the name of a file; choose another.")


def _as_path(path):
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path is a {type(path).__name__}; give a str or a Path.")
    return Path(path)


# --- reading --------------------------------------------------------------------------------------


_SOMETHING_ELSE = {  # what a file may be that goes under another's name, by its first bytes
    b"version https://git-lfs": "a pointer of Git LFS to it; fetch it with `git lfs pull`",
    b"<!doctype html": "a page of the web; download the file itself",
    b"<html": "a page of the web; download the file itself",
    b"\x1f\x8b": "packed with gzip; unpack it first",
    b"kaydara fbx": "an FBX file; open it in Blender and save it as GLB",
}


def existing_file(path, what):
    """The path as a `Path`, refused unless it is a file with something in it that may be read.

    Files that are plainly something else (a web page, a pointer of Git LFS) are refused as that.

    Parameters
    ----------
    path : str or Path
    what : str
        What the file should be, for the message ("OBJ file").

    Raises
    ------
    FileNotFoundError, PermissionError, ValueError, TypeError
        For a missing file, one that may not be read, a folder, a pipe, an empty file or one of
        another kind, or what is no path.
    """
    path = _as_path(path)
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise FileNotFoundError(f"path={str(path)!r}: there is no such {what}.") from None
    except (OSError, ValueError) as error:
        raise _no_path(path, error) from error
    if not path.is_file():
        raise ValueError(f"path={str(path)!r} is not a file; give the path of one {what}.")
    if not os.access(path, os.R_OK):
        raise PermissionError(f"path={str(path)!r} may not be read; allow reading this {what}.")
    if found.st_size == 0:
        raise ValueError(f"path={str(path)!r} is empty; export the {what} again.")
    with open(path, "rb") as file:
        head = file.read(64).lower().removeprefix(codecs.BOM_UTF8).lstrip()
    for mark, said in _SOMETHING_ELSE.items():
        if head.startswith(mark):
            raise ValueError(f"{path} is no {what}, but {said}.")
    return path


# --- npz ------------------------------------------------------------------------------------------


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
    if _as_path(path).suffix != ".npz":
        raise ValueError(f"path={str(path)!r} must end in .npz.")
    arrays = {name: np.asarray(a) for name, a in arrays.items()}
    objects = [name for name, a in arrays.items() if a.dtype.kind not in _KINDS]
    if objects:
        raise TypeError(
            f"{', '.join(objects)}: Python objects cannot be stored; give plain arrays."
        )
    with atomic_path(path) as part, open(part, "wb") as out:
        listed = np.array(sorted(arrays), dtype=str)  # so that one taken away is missed
        about = dict(facelab_kind=kind, facelab_version=version, facelab_arrays=listed)
        np.savez_compressed(out, **about, **arrays)


def load_npz(path, kind, version):
    """Arrays of a file written by `save_npz`, as a dict; never unpickles anything.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is missing, damaged, of another kind or of another version, or if its arrays
        would take far more memory than a file of its size can mean.
    """
    with open_npz(path, kind, version) as stored:
        return {name: stored.read(name) for name in stored.names}


class NpzError(ValueError):
    """An npz file that is refused; the message names it."""


@contextlib.contextmanager
def open_npz(path, kind, version):
    """A file of `save_npz` as `StoredArrays`, open while the context lasts; see `load_npz`.

    A ValueError or TypeError inside is about what the file holds, and is made to name it.
    """
    path = existing_file(path, "npz file")
    with open(path, "rb") as file, StoredArrays(path, file) as stored:
        found = stored.read("facelab_kind", (), "U").item()
        found = found, stored.read("facelab_version", (), "iu").item()
        if found != (kind, version):
            raise NpzError(
                f"{path} holds {found[0]!r} of version {found[1]}, but {kind!r} of version "
                f"{version} is wanted; make the file again with this version of facelab."
            )
        if "facelab_arrays" in stored:  # older files do not say what they hold
            stored.refuse_missing(stored.read("facelab_arrays", ("n_arrays",), "U").tolist())
        try:
            yield stored
        except NpzError:
            raise
        except (ValueError, TypeError) as error:
            raise stored.refused(str(error).removesuffix(".")) from error


class StoredArrays:
    """The arrays of an npz file: headers are read and checked at once, numbers when asked for.

    What a header says must agree with the size of its part of the file, and all parts together
    with the size of the file, before any memory is taken.

    Parameters
    ----------
    path : Path
    file : binary file
        Of that path, open for reading.
    what : str
        What the file should be, for messages.
    """

    def __init__(self, path, file, what="facelab npz file"):
        self.path, self._what = path, what
        try:
            self._zip = zipfile.ZipFile(file)
            parts = self._zip.infolist()
        except Exception as error:  # a mere accident of the bytes decides which
            raise self.unreadable("it is no whole zip archive") from error
        size = path.stat().st_size
        self._headers = {}
        for part in parts:
            name = part.filename.removesuffix(".npy")
            if name in self._headers:
                raise self.unreadable(f"it holds {name[:40]!r} twice")
            self._headers[name] = self._header(part)
        if sum(part.compress_size for part in parts) > size:
            raise self.unreadable("its parts are larger than the file")
        total = sum(part.file_size for part in parts)
        if total > max(_SMALL, _GROWTH * size):
            raise self.unreadable(
                f"it would take {total / 1e9:.1f} GB of memory, {total / size:.0f} times its size"
            )

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._zip.close()

    def __contains__(self, name):
        return name in self._headers

    @property
    def names(self):
        """Names of the arrays, those that say what the file is left out: list of str."""
        return [name for name in self._headers if not name.startswith("facelab_")]

    def refuse_missing(self, names):
        """Refuse a file that has not just the arrays of these names."""
        missing, more = sorted(set(names) - set(self.names)), sorted(set(self.names) - set(names))
        if missing:
            raise self.refused(f"{', '.join(missing[:6])} should be there")
        if more:
            raise self.refused(f"{', '.join(more[:6])} should not be there")

    def refuse_others(self, names):
        """Refuse a file that has arrays beside those of these names."""
        self.refuse_missing(set(names) & set(self.names))

    def shape(self, name):
        """Shape of an array, as its header has it; the array is not read."""
        return self._found(name)[0]

    def read(self, name, shape=None, kinds=_KINDS):
        """One array, refused by its header unless it is as wanted.

        Parameters
        ----------
        name : str
        shape : tuple of (int or str), optional
            A string stands for any length and names it.
        kinds : str
            Kinds of numpy types that it may have: b, i, u, f, U.
        """
        found, dtype = self._found(name)
        if shape is not None and not (
            len(found) == len(shape)
            and all(isinstance(w, str) or w == n for w, n in zip(shape, found, strict=True))
        ):
            wanted = "(" + ", ".join(map(str, shape)) + ")"
            raise self.refused(f"{name} has shape {found}, but shape {wanted} is wanted")
        if dtype.kind not in kinds:
            words = {"b": "booleans", "i": "integers", "u": "", "f": "numbers", "U": "text"}
            wanted = " or ".join(words[k] for k in kinds if words[k])
            raise self.refused(f"{name} is of type {dtype}, but {wanted} are wanted")
        try:
            with self._zip.open(f"{name}.npy") as stream:
                array = np.lib.format.read_array(stream, allow_pickle=False)
                stream.read(1)  # to the end, where the checksum is compared
        except Exception as error:
            raise self.unreadable(f"{name} is damaged") from error
        return array

    def unreadable(self, why):
        """What to raise for a file that is no such npz."""
        return NpzError(f"{self.path}: not a readable {self._what} ({why}).")

    def refused(self, why):
        """What to raise for a file whose content does not fit together."""
        return NpzError(
            f"{self.path}: parts of it are missing or do not fit together ({why}); save it again."
        )

    def _found(self, name):
        if name not in self._headers:
            if name.startswith("facelab_"):
                raise self.unreadable(f"it has no {name}")
            raise self.refused(f"it has no {name}")
        return self._headers[name]

    def _header(self, part):
        """Shape and type of one part, refused if they and the archive tell different sizes."""
        name = part.filename[:40]
        if not part.filename.endswith(".npy"):
            raise self.unreadable(f"{name!r} in it is no array")
        if part.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise self.unreadable(f"{name} is packed in a way that is not used here")
        try:
            with self._zip.open(part) as stream:
                version = np.lib.format.read_magic(stream)
                read = {
                    (1, 0): np.lib.format.read_array_header_1_0,
                    (2, 0): np.lib.format.read_array_header_2_0,
                }[version]
                shape, _, dtype = read(stream)
                start = stream.tell()
        except Exception as error:
            raise self.unreadable(f"the header of {name} is damaged") from error
        if dtype.kind not in _KINDS:
            raise self.unreadable(f"{name} is no plain array of numbers or text")
        size = start + math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or size != part.file_size:
            raise self.unreadable(f"{name} is not as large as its header says")
        if part.file_size > _SQUEEZED * part.compress_size + 4096:
            raise self.unreadable(f"{name} is larger than its packed form can hold")
        return shape, dtype
