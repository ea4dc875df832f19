"""New data of a glTF file: bytes, and what describes them in its JSON.

References
----------
Khronos Group, glTF 2.0 specification, sections 3.6 (binary data), 3.7.2.2 (morph targets),
3.11 (animations) and 4 (GLB).
"""

import json
import struct

import numpy as np

ARRAY, ELEMENTS = 34962, 34963
"""What a view is for: attributes of vertices, or indices."""

FLOAT, UINT = 5126, 5125
_STILL = 1e-9  # of the file's unit: smaller displacements are left out of sparse targets


class GltfPieces:
    """The JSON of a glTF file to which data are added.

    Parameters
    ----------
    told : dict
        The JSON.

    Attributes
    ----------
    added : bytearray
        The new bytes. Views of them have no buffer (None) until whoever writes the file gives one.
    """

    def __init__(self, told):
        self.json, self.added = told, bytearray()

    def append(self, where, item):
        """Add an object to one of the lists of the file: its index."""
        self.json.setdefault(where, []).append(item)
        return len(self.json[where]) - 1

    def stored(self, data):
        """Add bytes: what a view says of their place."""
        self.added += bytes(-len(self.added) % 4)
        self.added += data
        begin = len(self.added) - len(data)
        return {"buffer": None, "byteOffset": begin, "byteLength": len(data)}

    def view(self, array, target=None):
        """Add a view of an array: its index."""
        what = {} if target is None else {"target": target}
        return self.append("bufferViews", self.stored(array.tobytes()) | what)

    def accessor(self, array, kind, target=None, bounds=False, rows=None):
        """Add an accessor of an array, or of zeros but for some rows of it: its index.

        Whole numbers are stored as uint32, all else as float32.
        """
        whole = array.dtype.kind in "iu"
        array = array.astype("<u4" if whole else "<f4")
        at = {"componentType": UINT if whole else FLOAT, "count": len(array), "type": kind}
        at |= bounds_of(array) if bounds else {}
        if rows is None:
            at |= {"bufferView": self.view(array, target), "byteOffset": 0}
        else:
            where = {"bufferView": self.view(rows.astype("<u4")), "componentType": UINT}
            values = {"bufferView": self.view(array[rows])}
            at["sparse"] = {"count": len(rows), "indices": where, "values": values}
        return self.append("accessors", at)

    def target(self, moved):
        """Add a morph target of displacements, sparse where few vertices move: its accessor."""
        moved = moved.astype("<f4")
        rows = np.flatnonzero((np.abs(moved) > _STILL).any(axis=1))
        if 4 * len(rows) >= 3 * len(moved):  # an index and three numbers against three numbers
            return self.accessor(moved, "VEC3", ARRAY, bounds=True)
        rows = rows if len(rows) else np.array([0])  # none at all is not allowed
        small = np.zeros_like(moved)
        small[rows] = moved[rows]
        return self.accessor(small, "VEC3", bounds=True, rows=rows)

    def animation(self, name, times, tracks, interpolation="LINEAR"):
        """Add keys of morph targets: the animation, which is not in the file yet.

        Parameters
        ----------
        name : str
        times : ndarray of shape (n_keys,)
            Seconds.
        tracks : list of (ndarray, list of int)
            Weights at those times, and the nodes that have them.
        interpolation : {"LINEAR", "STEP", "CUBICSPLINE"}
        """
        moment, samplers, channels = self.accessor(times, "SCALAR", bounds=True), [], []
        for k, (weights, nodes) in enumerate(tracks):
            output = self.accessor(weights.ravel(), "SCALAR")
            samplers.append({"input": moment, "output": output, "interpolation": interpolation})
            channels += [
                {"sampler": k, "target": {"node": node, "path": "weights"}} for node in nodes
            ]
        return {"name": name, "samplers": samplers, "channels": channels}


def bounds_of(array):
    """Least and largest numbers of an array, as an accessor has them."""
    low, high = np.atleast_1d(array.min(axis=0)), np.atleast_1d(array.max(axis=0))
    return {"min": low.astype(float).tolist(), "max": high.astype(float).tolist()}


def json_text(told):
    """JSON as bytes."""
    text = json.dumps(told, ensure_ascii=False, separators=(",", ":"))
    return text.encode(errors="backslashreplace")  # half a character, as JSON may hold it


def glb_bytes(told, body, further=()):
    """A GLB of its JSON, its bytes, and further chunks."""
    text = json_text(told)
    chunks = [(b"JSON", text + b" " * (-len(text) % 4))]
    if body is not None:
        chunks.append((b"BIN\0", body + bytes(-len(body) % 4)))
    chunks += further
    packed = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in chunks)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(packed)) + packed
