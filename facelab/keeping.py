"""Folders that are made on first use and kept, sealed, as long as the code that made them stands.

A kept folder holds files and a manifest: the key (the settings and the code that the files follow
from), a checksum of each file, and a seal over both. What is not as it was sealed is made again.
"""

import ast
import atexit
import functools
import hashlib
import importlib.util
import json
import os
import shutil
import tempfile
import time
import uuid
import warnings
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pooch

from facelab.storage import load_npz, save_npz

try:
    import fcntl
except ImportError:  # no such locks on Windows
    fcntl = None

MANIFEST = "manifest.json"
_ABANDONED = 6 * 3600  # seconds; where there are no locks, a maker is taken for dead after that
_OURS = ("facelab", "data_synth")
_IMPORTED = time.time()


def _sha256(path):
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _seal_of(manifest):
    body = {"key": manifest["key"], "files": manifest["files"]}
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def read_manifest(folder):
    """The manifest of a sealed folder: dict with `key`, `files` and `seal`.

    Raises
    ------
    OSError, ValueError
        If there is none, or it is not as it was sealed.
    """
    try:
        manifest = json.loads((Path(folder) / MANIFEST).read_text(encoding="utf-8"))
        whole = manifest["seal"] == _seal_of(manifest)
    except (ValueError, KeyError, TypeError, RecursionError):
        whole = False
    if not whole:
        raise ValueError("its manifest is damaged")
    return manifest


def fault(folder, key=None):
    """What is wrong with a sealed folder, in words; None if it is whole.

    Parameters
    ----------
    folder : str or Path
    key : dict, optional
        Entries that its key must have.
    """
    folder = Path(folder)
    try:
        manifest = read_manifest(folder)
    except FileNotFoundError:
        return "it has no manifest"
    except (OSError, ValueError) as error:
        return str(error)
    differs = [name for name, v in (key or {}).items() if manifest["key"].get(name) != v]
    if differs:
        return f"it was made with another {', '.join(differs)}"
    for name, digest in manifest["files"].items():
        try:
            if _sha256(folder / name) != digest:
                return f"{name} is damaged"
        except FileNotFoundError:
            return f"{name} is missing"
        except OSError as error:
            return f"{name} cannot be read ({error.strerror})"
    return None


def build(folder, key, make):
    """Make a sealed folder, whole or not at all.

    Parameters
    ----------
    folder : Path
        Must not exist, or be empty.
    key : dict
        What the files follow from, as JSON has it.
    make : callable
        Writes the files into the folder that it is given.

    Raises
    ------
    FileExistsError
        If the folder holds something already.
    """
    if folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"folder={str(folder)!r} holds something already; name another one.")
    with _made(folder, key, make) as part:
        if folder.exists():
            folder.rmdir()
        part.rename(folder)


def keep(folder, key, make, read, spare=False):
    """What a sealed folder holds, made on first use and again where it is in doubt.

    Any number of processes may ask for the same folder at once: all get a whole one.

    Parameters
    ----------
    folder : Path
    key : dict
        What the files follow from, as JSON has it: one made with another key is made again.
    make : callable
        Writes the files into the folder that it is given.
    read : callable
        Takes a whole folder and gives what is returned.
    spare : bool, default=False
        Where the folder cannot be written, use a temporary one as long as the program runs, and
        warn.

    Raises
    ------
    OSError
        If the folder cannot be written, or the disk is full.
    """
    if fault(folder, key) is None:
        with suppress(OSError, ValueError, KeyError):  # replaced by other code meanwhile
            return read(folder)
    if spare:
        folder = writable(folder.parent) / folder.name
        return keep(folder, key, make, read)
    with _made(folder, key, make) as part, _held(folder.parent):
        if fault(folder, key) is not None:  # else another process was faster
            if folder.exists() or folder.is_symlink():
                stale = _new_part(folder)
                folder.rename(stale / folder.name)
                shutil.rmtree(stale, ignore_errors=True)
            try:
                part.rename(folder)
            except OSError:
                if fault(folder, key) is not None:  # else, where there are no locks, as above
                    raise
    return read(folder)


@contextmanager
def _made(folder, key, make):
    """A sealed folder beside `folder`, to be renamed; what was not renamed vanishes."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        with _held(folder.parent):  # nobody sweeps between its making and its being held
            _sweep(folder.parent)
            part = _new_part(folder)
            stack.callback(shutil.rmtree, part, ignore_errors=True)
            stack.enter_context(_held(part))
        make(part)
        files = {f.name: _sha256(f) for f in sorted(part.iterdir())}
        manifest = {"key": key, "files": files}
        manifest["seal"] = _seal_of(manifest)
        (part / MANIFEST).write_text(json.dumps(manifest, indent=1), encoding="utf-8")
        yield part


def _new_part(folder):
    part = folder.parent / f".{folder.name}.{uuid.uuid4().hex[:12]}.part"
    part.mkdir()
    return part


@contextmanager
def _held(folder, wait=True):
    """Hold a folder against other processes; the system lets go of it when a process dies.

    Yields whether it is held: not where the system, or the file system, has no such locks.

    Raises
    ------
    BlockingIOError
        If another process holds it, and there is no waiting.
    """
    if fcntl is None:
        yield False
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
            held = True
        except BlockingIOError:
            raise
        except OSError:
            held = False
        yield held
    finally:
        os.close(handle)


def _sweep(folder):
    """Remove what killed makers left behind."""
    for part in folder.glob(".*.part"):
        with suppress(OSError), _held(part, wait=False) as dead:  # BlockingIOError: at work
            if dead or time.time() - part.stat().st_mtime > _ABANDONED:
                shutil.rmtree(part, ignore_errors=True)


# --- the cache ------------------------------------------------------------------------------------


def cache_dir():
    """Folder for downloaded and made data: `FACELAB_CACHE`, else the user's cache folder."""
    folder = Path(os.environ.get("FACELAB_CACHE") or pooch.os_cache("facelab"))
    with suppress(OSError):  # what cannot be kept there is kept in a temporary folder
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def keep_arrays(name, key, make):
    """Arrays that are kept in the cache, made on first use and again where they are in doubt.

    Parameters
    ----------
    name : str
        Folder within `cache_dir()`.
    key : dict
        What the arrays follow from, as JSON has it; see `source_stamp`.
    make : callable
        Gives the arrays: dict of str to array_like.

    Returns
    -------
    dict of str to ndarray
    """
    about = "arrays.npz", "facelab-cache", 1

    def write(folder):
        save_npz(folder / about[0], *about[1:], **make())

    def read(folder):
        return load_npz(folder / about[0], *about[1:])

    return keep(cache_dir() / name, key, write, read, spare=True)


# --- where nothing can be written -----------------------------------------------------------------


def writable(folder):
    """The folder, made if need be; or a temporary one in its place, with a warning.

    The temporary one is the same for the same name, and lasts as long as the program runs.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        return folder
    except OSError as error:
        warnings.warn(
            f"{folder} cannot be written ({error.strerror}): what is made now is kept in a "
            "temporary folder, and lost when the program ends. Name another cache in "
            "FACELAB_CACHE.",
            stacklevel=2,
        )
        return _spare() / folder.name


@functools.cache
def _spare():
    folder = Path(tempfile.mkdtemp(prefix="facelab-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


# --- the code that something hangs on -------------------------------------------------------------


def source_stamp(*modules):
    """Fingerprint of some modules and of all that they import of facelab and data_synth.

    Imports are found in the sources, those within functions too; nothing is imported for it. A
    program that runs on while its files are edited gets a fingerprint that no other one has: what
    it makes follows from code that is nowhere any more.

    Parameters
    ----------
    *modules : str
        Names, such as "facelab.models".

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    found, waiting = {}, list(modules)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found[name], imports = _read(name)
            waiting += imports
    return hashlib.sha256(repr(sorted(found.items())).encode()).hexdigest()[:16]


@functools.cache
def _read(name):
    """Checksum of a module's source, and the names of our modules that it imports."""
    file = _file(name)
    source = file.read_bytes()
    package = name if file.stem == "__init__" else name.rpartition(".")[0]
    imports = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            imports |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            origin = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            # what is no module of its own is a name in the module that it comes from
            names = (f"{origin}.{alias.name}" for alias in node.names)
            imports |= {name if _file(name) else origin for name in names}
    edited = file.stat().st_mtime > _IMPORTED
    digest = uuid.uuid4().hex if edited else hashlib.sha256(source).hexdigest()
    return digest, [name for name in imports if _file(name)]


@functools.cache
def _file(name):
    """Source file of a module of ours, None if there is no such module."""
    top, *rest = name.split(".")
    if top not in _OURS:
        return None
    place = Path(importlib.util.find_spec(top).submodule_search_locations[0], *rest)
    for file in (place.with_suffix(".py"), place / "__init__.py"):
        if file.is_file():
            return file
    return None
