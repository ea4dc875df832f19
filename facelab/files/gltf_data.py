"""The data of a glTF 2.0 file, text or binary: its JSON, buffers, views and accessors.

References
----------
Khronos Group, glTF 2.0 specification, sections 3.6 (binary data) and 4 (GLB).
"""

import base64
import binascii
import re
import struct
import urllib.parse
import warnings

import numpy as np

from facelab.files import meshopt
from facelab.files.json_items import load_json
from facelab.files.pictures import bytes_beside
from facelab.files.words import damaged
from facelab.storage import existing_file

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_HARMLESS = re.compile(  # extensions that change looks, not shapes
    r"KHR_(materials|texture|lights|xmp|animation_pointer|node_visibility)\w*"
    r"|EXT_(texture|lights)_\w+|MSFT_texture_dds|VRM|VRMC_\w+"
)
_READ = {"KHR_mesh_quantization", "EXT_meshopt_compression", "KHR_draco_mesh_compression"}
_ROOM = 256 << 20  # bytes that any file may unfold to; larger ones to a hundred times their size
_KNOWN = {
    "accessors": "bufferView byteOffset componentType normalized count type max min sparse name",
    "bufferViews": "buffer byteOffset byteLength byteStride target name",
    "buffers": "uri byteLength name",
    "meshes": "primitives weights name",
    "nodes": "camera children skin matrix mesh rotation scale translation weights name",
    "skins": "inverseBindMatrices skeleton joints name",
    "scenes": "nodes name",
    "animations": "channels samplers name",
}


class GltfData:
    """A glTF or GLB file, checked and opened.

    Parameters
    ----------
    path : str or Path

    Attributes
    ----------
    path : Path
    json : Item
        The JSON of the file.
    lists : dict of str to list of Item
        Its "accessors", "bufferViews", "buffers", "meshes", "nodes", "skins", "scenes" and
        "animations".
    binary : bytes or None
        The binary chunk of a GLB.
    further : list of (bytes, bytes) or None
        Kind and data of the other chunks of a GLB, which mean nothing to glTF.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing, empty or damaged file, another version of glTF, or an extension that it
        requires and that cannot be read; by name.
    """

    def __init__(self, path):
        self.path = existing_file(path, "glTF file")
        data = self.path.read_bytes()
        self.binary = self.further = None
        text = self._chunks(data) if data[:4] == b"glTF" else data
        self.json = load_json(text, self.path, "glTF file")
        version = self.json.item("asset").text("version", "missing")
        if not re.fullmatch(r"2\.\d+", version):
            raise ValueError(
                f"{self.path}: asset.version is {version[:20]!r}, but glTF 2.0 is read; convert "
                "the file, for example by opening it in Blender and exporting it as glTF 2.0."
            )
        self._refuse_extensions()
        self.lists = {name: self.json.items(name) for name in _KNOWN}
        for name, known in _KNOWN.items():
            for item in self.lists[name]:
                item.warn_unknown(known.split())
        self._room = max(_ROOM, 100 * len(data))
        self._buffers, self._views, self._drawn = {}, {}, {}

    def _chunks(self, data):
        """The JSON of a GLB; its binary chunk is kept."""
        if len(data) < 20:
            raise ValueError(f"{self.path}: the file ends after {len(data)} bytes; copy it again.")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise ValueError(
                f"{self.path}: GLB version {version}, but version 2 is read; convert the file."
            )
        if length != len(data):
            raise ValueError(
                f"{self.path}: the header promises {length} bytes, the file has {len(data)}; it "
                "was cut short or changed on the way, copy it again."
            )
        found, at = [], 12
        while at < len(data):
            size, kind = struct.unpack_from("<I4s", data, at) if at + 8 <= len(data) else (0, b"")
            if not kind or at + 8 + size > len(data):
                raise damaged(f"{self.path}: the chunk at byte {at} does not fit into the file")
            found.append((kind, data[at + 8 : at + 8 + size]))
            at += 8 + size
            if found[0][0] != b"JSON":
                raise damaged(f"{self.path}: its first chunk is not JSON")
        (_, text), *rest = found
        self.binary = rest.pop(0)[1] if rest and rest[0][0] == b"BIN\0" else None
        self.further = rest
        return text

    def _refuse_extensions(self):
        required = self.json.texts("extensionsRequired")
        unknown = [n for n in required if n not in _READ and not _HARMLESS.fullmatch(n)]
        if unknown:
            raise ValueError(
                f"{self.path}: it requires {', '.join(unknown)}, which is not read here; export "
                "the file again without, or run it through `gltf-transform copy`."
            )

    def need(self, n_bytes, what):
        """Take note of memory that is about to be taken; refuse what no such file is worth."""
        self._room -= n_bytes
        if self._room < 0:
            raise ValueError(
                f"{self.path}: {what} would unfold to {n_bytes / 1e6:,.0f} MB, far more than a "
                "file of this size holds; the file is damaged."
            )

    # --- buffers and views ------------------------------------------------------------------------

    def _buffer(self, index):
        if index not in self._buffers:
            item = self.lists["buffers"][index]
            length = item.whole("byteLength", low=1)
            uri = item.text("uri")
            if uri is None and index == 0 and self.binary is not None:
                data = self.binary
                if len(data) - length > 3:
                    raise item.damaged(
                        f"is {length}, but the binary chunk has {len(data)} bytes", "byteLength"
                    )
            elif uri is None:
                raise item.damaged("has no data")
            else:
                data = self.from_uri(item, uri)
            if len(data) < length:
                raise item.damaged(
                    f"is {length}, but its data end after {len(data)} bytes", "byteLength"
                )
            self._buffers[index] = memoryview(data)[:length]
        return self._buffers[index]

    def from_uri(self, item, uri, most=None):
        """Bytes of a data URI, or of a file (of at most so many bytes) beside this one."""
        if uri.startswith("data:"):
            head, comma, body = uri.partition(",")
            if not comma or not head.endswith(";base64"):
                raise ValueError(f"{self.path}: {item.at('uri')} holds no data in base64.")
            try:
                return base64.b64decode(body, validate=True)
            except (binascii.Error, ValueError):
                raise ValueError(
                    f"{self.path}: {item.at('uri')} is damaged: it is no base64."
                ) from None
        return bytes_beside(self.path, urllib.parse.unquote(uri), item.at("uri"), most)

    def view(self, index):
        """The bytes of a buffer view, unpacked, and its stride (0: packed tightly)."""
        if index not in self._views:
            item = self.lists["bufferViews"][index]
            packed = item.item("extensions").item("EXT_meshopt_compression")
            if packed.value:
                self._views[index] = self._unpacked(item, packed)
            else:
                stride = item.whole("byteStride", 0, high=252)
                if stride and (stride < 4 or stride % 4):
                    raise item.wrong("byteStride", "a multiple of 4 from 4 to 252")
                self._views[index] = self._slice(item), stride
        return self._views[index]

    def _slice(self, item):
        data = self._buffer(item.index("buffer", self.lists["buffers"]))
        start, length = item.whole("byteOffset", 0), item.whole("byteLength", low=1)
        if start + length > len(data):
            raise item.damaged(f"ends at byte {start + length}, but its buffer has {len(data)}")
        return data[start : start + length]

    def _unpacked(self, item, packed):
        count = packed.whole("count", low=1)
        stride = packed.whole("byteStride", low=1, high=256)
        mode, way = packed.text("mode"), packed.text("filter", "NONE")
        fits = {"ATTRIBUTES": stride % 4 == 0, "TRIANGLES": stride in (2, 4)}
        if mode not in ("ATTRIBUTES", "TRIANGLES", "INDICES") or not fits.get(
            mode, stride in (2, 4)
        ):
            raise packed.wrong("mode", "ATTRIBUTES, TRIANGLES or INDICES with a stride that fits")
        if count * stride != item.whole("byteLength", low=1):
            raise packed.damaged(
                f"has {count} elements of {stride} bytes, but its view has "
                f"{item.value['byteLength']}"
            )
        self.need(count * stride, packed.place)
        try:
            data = meshopt.decode(bytes(self._slice(packed)), count, stride, mode, way)
        except ValueError as error:
            raise damaged(f"{self.path}: {packed.place}: {error}") from None
        return memoryview(data), stride if mode == "ATTRIBUTES" else 0

    # --- accessors --------------------------------------------------------------------------------

    def count(self, index):
        """Number of elements of an accessor."""
        return self.lists["accessors"][index].whole("count", low=1)

    def array(self, index, kind, wholes=False):
        """The elements of an accessor.

        Parameters
        ----------
        index : int
        kind : str
            Wanted type, "VEC3".
        wholes : bool, default=False
            Whole numbers are wanted, as of indices and joints.

        Returns
        -------
        ndarray of shape (count, width) or, of scalars, (count,)
            Floats as float32, normalised integers as the numbers they stand for; whole numbers
            as they are.
        """
        item = self.lists["accessors"][index]
        if item.text("type") != kind:
            raise item.wrong("type", kind)
        component = item.whole("componentType")
        if component not in COMPONENTS:
            raise item.wrong("componentType", f"one of {', '.join(map(str, COMPONENTS))}")
        dtype, width = np.dtype(COMPONENTS[component]), _WIDTHS[kind]
        if wholes and dtype.kind != "u":
            raise item.wrong("componentType", "5121, 5123 or 5125, of whole numbers")
        count = self.count(index)
        if "bufferView" in item:
            out = self._read(item, dtype, width, count)
        else:
            self.need(count * width * dtype.itemsize, item.place)
            out = np.zeros((count, width), dtype)
        if "sparse" in item:
            out = self._changed(item.item("sparse"), out, dtype, width)
        if not wholes:
            out = self._numbers(item, out, dtype)
        return out[:, 0] if kind == "SCALAR" else out

    def _read(self, item, dtype, width, count):
        """Elements as they stand in the buffer view of an accessor, or of a part of one."""
        data, stride = self.view(item.index("bufferView", self.lists["bufferViews"]))
        offset = item.whole("byteOffset", 0)
        size = width * dtype.itemsize
        stride = stride or size
        if offset % dtype.itemsize or stride < size:
            raise item.damaged(
                f"lies askew in its buffer view (offset {offset}, {stride} bytes from one element "
                f"to the next of {size})"
            )
        end = offset + stride * (count - 1) + size
        if end > len(data):
            raise item.damaged(f"needs {end} bytes, but its buffer view has {len(data)}")
        strides = (stride, dtype.itemsize)
        return np.ndarray((count, width), dtype, data, offset, strides)

    def _changed(self, sparse, base, dtype, width):
        """The base with some of its elements replaced."""
        count = sparse.whole("count", low=1, high=len(base))
        where, values = sparse.item("indices"), sparse.item("values")
        component = where.whole("componentType")
        if component not in (5121, 5123, 5125):
            raise where.wrong("componentType", "5121, 5123 or 5125")
        rows = self._read(where, np.dtype(COMPONENTS[component]), 1, count)
        rows = rows[:, 0].astype(np.int64)
        if (np.diff(rows) <= 0).any() or rows[-1] >= len(base):
            raise where.damaged(f"must ascend and stay below {len(base)}")
        out = base.copy()
        out[rows] = self._read(values, dtype, width, count)
        return out

    def _numbers(self, item, out, dtype):
        """Floats from what is stored, checked against the bounds that the file declares."""
        low, high = (item.numbers(k, out.shape[1]) for k in ("min", "max"))
        if low is not None and high is not None and dtype.kind == "f":
            slack = 1e-3 * (np.array(high) - low).max() + 1e-6 * np.abs([low, high]).max()
            if (out.min(axis=0) < low - slack).any() or (out.max(axis=0) > high + slack).any():
                warnings.warn(
                    f"{self.path}: {item.place} holds {out.min(axis=0).tolist()} to "
                    f"{out.max(axis=0).tolist()}, but declares {low} to {high}; the program that "
                    "wrote it was careless, or the file is damaged.",
                    stacklevel=2,
                )
        if dtype.kind == "f":
            return out
        if not item.flag("normalized"):
            return out.astype(np.float32)
        most = np.iinfo(dtype).max
        return np.maximum(out.astype(np.float32) / np.float32(most), np.float32(-1))

    def attribute(self, primitive, semantic, kind, wholes=False):
        """An attribute of a primitive's vertices, Draco's or plain; parameters of `array`."""
        attributes, accessors = primitive.item("attributes"), self.lists["accessors"]
        count = self.count(attributes.index("POSITION", accessors))
        index, packed = attributes.index(semantic, accessors), self.draco(primitive)
        if packed and semantic in packed[1]:
            array = self.drawn(primitive, semantic, _WIDTHS[kind])
            if wholes or array.dtype.kind == "f":
                return array
            return self._numbers(accessors[index], array, array.dtype)
        array = self.array(index, kind, wholes)
        if len(array) != count:
            raise attributes.damaged(f"has {len(array)} elements, but POSITION {count}", semantic)
        return array

    # --- Draco ------------------------------------------------------------------------------------

    def draco(self, primitive):
        """The mesh of a primitive that Draco compressed, as DracoPy gives it, or None."""
        packed = primitive.item("extensions").item("KHR_draco_mesh_compression")
        if not packed.value:
            return None
        index = packed.index("bufferView", self.lists["bufferViews"])
        if index not in self._drawn:
            try:
                import DracoPy
            except ImportError:
                raise ValueError(
                    f"{self.path}: {primitive.place} is compressed with KHR_draco_mesh_compression;"
                    ' install what reads it by `pip install "facelab[glb]"`, or run the file '
                    "through `gltf-transform copy`."
                ) from None
            data = bytes(self.view(index)[0])
            try:
                mesh = DracoPy.decode(data)
            except Exception:  # DracoPy has no one kind of its own
                mesh = None
            if not isinstance(mesh, DracoPy.DracoMesh):  # or it is a cloud of points
                raise packed.damaged("has Draco data that are damaged or hold no triangles")
            self._drawn[index] = mesh
        return self._drawn[index], packed.item("attributes")

    def drawn(self, primitive, semantic, width=None):
        """An attribute as Draco stores it, checked against what its accessor promises."""
        attributes, accessors = primitive.item("attributes"), self.lists["accessors"]
        count = self.count(attributes.index("POSITION", accessors))
        width = width or _WIDTHS.get(accessors[attributes.index(semantic, accessors)].text("type"))
        mesh, packed = self.draco(primitive)
        found = mesh.get_attribute_by_unique_id(packed.whole(semantic))
        array = None if found is None else np.asarray(found["data"])
        if array is None or array.shape != (count, width):
            raise primitive.damaged(
                f"has Draco data that do not hold the {count} {semantic} it promises"
            )
        return array
