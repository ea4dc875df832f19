"""Arrays of an npz file that somebody else wrote: sizes held against it, nothing unpickled."""

import math
import zipfile

import numpy as np

from facelab.storage import existing_file

_MOST_RATIO = 1100  # deflate cannot press zeros further than to a 1032nd
_ROOM = 2**28  # bytes that an array may have however small its file is
_LIKELY_RATIO = 100


def read_arrays(path, names):
    """The arrays of these names in an npz file; those that it does not have are left out.

    Parameters
    ----------
    path : str or Path
    names : sequence of str

    Returns
    -------
    dict of str to ndarray
        Numbers and strings only.

    Raises
    ------
    FileNotFoundError, ValueError
        For a file that is no npz, damaged, with Python objects, or with arrays that are out of all
        proportion to it.
    """
    path = existing_file(path, "npz file")
    try:
        with zipfile.ZipFile(path) as archive:
            stored = set(archive.namelist())
            infos = {n: archive.getinfo(f"{n}.npy") for n in names if f"{n}.npy" in stored}
            arrays = {n: _read(archive, info) for n, info in infos.items()}
    except _Refused as refused:
        raise ValueError(f"{path}: {refused}") from None
    except Exception:  # zip, deflate and header refusals each raise their own
        raise ValueError(
            f"{path}: not a readable npz file, or damaged; write it again with numpy.savez."
        ) from None
    return arrays


class _Refused(Exception):
    pass


def _read(archive, info):
    name = info.filename
    with archive.open(info) as stream:
        version = np.lib.format.read_magic(stream)
        read = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}
        shape, fortran, dtype = read[version[0]](stream)
        if dtype.hasobject or dtype.kind not in "biufUS":
            raise _Refused(f"{name} holds {dtype}; numbers or strings are wanted.")
        size = math.prod(shape) * dtype.itemsize
        pressed = max(info.compress_size, 1)
        if size != info.file_size - stream.tell() or size > _MOST_RATIO * pressed + 10**4:
            raise _Refused(f"{name} should be {size} bytes, which the file does not have.")
        if size > _ROOM and size > _LIKELY_RATIO * pressed:
            raise _Refused(
                f"{name} would take {size / 1e9:.1f} GB out of {pressed} bytes; that is no capture."
            )
        data = bytearray(size)
        at = memoryview(data)
        while len(at) and (count := stream.readinto(at)):
            at = at[count:]
        if len(at) or stream.read(1):
            raise _Refused(f"{name} is damaged.")
    array = np.frombuffer(data, dtype)
    return array.reshape(shape, order="F" if fortran else "C")
