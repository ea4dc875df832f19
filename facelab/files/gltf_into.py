"""Morph targets and an animation added to a glTF file; all else keeps its bytes.

References
----------
Khronos Group, glTF 2.0 specification, sections 3.7.2.2 (morph targets) and 3.11 (animations).
"""

import base64
import copy
from pathlib import Path

import numpy as np

from facelab.files.gltf_data import COMPONENTS
from facelab.files.gltf_read import GltfScene
from facelab.files.gltf_write import (
    ARRAY,
    ELEMENTS,
    UINT,
    GltfPieces,
    bounds_of,
    glb_bytes,
    json_text,
)
from facelab.storage import atomic_path


class GltfEdit(GltfPieces):
    """A glTF, GLB or VRM file, opened to add shapes and an animation to one of its meshes.

    Parameters
    ----------
    path : str or Path
    mesh : str
        Its part, as `GltfScene` names it.

    Attributes
    ----------
    n_vertices, n_targets : int
        Of that part, before anything was added.
    vertices : ndarray of shape (n_vertices, 3)
        Where the scene places them, metres.
    unpacked : tuple of str
        Extensions of compression that the file used; it is saved without them.
    """

    def __init__(self, path, mesh):
        self._scene = scene = GltfScene(path)
        self._data = scene.data
        k = scene.find(mesh)
        self._part = scene.part(k)
        self._node, self._mesh = scene.place(k)
        self.vertices = self._part.vertices
        self.n_vertices, self.n_targets = len(self.vertices), scene.n_targets(k)
        super().__init__(copy.deepcopy(self._data.json.value))
        self._names = list(self._part.names)
        self._new, self._animation = [], None
        self.unpacked = self._unpack()

    # --- what is new ------------------------------------------------------------------------------

    def add_shape(self, name, moved):
        """Add a morph target: displacements where the scene places the part, metres."""
        linear = self._part.linear
        moved = np.linalg.solve(linear, np.asarray(moved, float)[..., None])[..., 0]
        added = {}
        for i, primitive in enumerate(self.json["meshes"][self._mesh]["primitives"]):
            count = self.json["accessors"][primitive["attributes"]["POSITION"]]["count"]
            begin = self._part.start.get(i)
            if (begin, count) not in added:  # primitives may share their vertices
                own = np.zeros((count, 3))
                if begin is not None:  # lines and points are no vertices here: they stay
                    own[:] = moved[begin : begin + count]
                added[begin, count] = self.target(own)
            primitive.setdefault("targets", []).append({"POSITION": added[begin, count]})
        self._new.append(name)

    def add_animation(self, times, weights, others):
        """Add keys of all targets, old and new, and of other parts that move along.

        Parameters
        ----------
        times : ndarray of shape (n_keys,)
            Seconds.
        weights : ndarray of shape (n_keys, n_targets)
        others : dict of str to ndarray of shape (n_keys, n_targets_of_it)
            By the parts' names.
        """
        if self._node is None:
            raise ValueError(
                f"{self._data.path}: it has no nodes, so nothing in it can move; export it again "
                "with a scene."
            )
        keys = {self._node: weights}
        for name, own in others.items():
            node, mesh = self._scene.place(self._scene.find(name))
            keys[node] = weights if mesh == self._mesh else own
        tracks = [(own, [node]) for node, own in keys.items()]
        self._animation = self.animation("facelab", np.asarray(times), tracks)

    def _of(self, where):
        return self.json.get(where, [])

    # --- compression ------------------------------------------------------------------------------

    def _unpack(self):
        """Write what was compressed as plain data; names of the extensions."""
        found = set()
        for k, view in enumerate(self._of("bufferViews")):
            packed = view.get("extensions", {}).pop("EXT_meshopt_compression", None)
            if packed is not None:
                found.add("EXT_meshopt_compression")
                view |= self.stored(self._data.view(k)[0])
        for m, mesh in enumerate(self._of("meshes")):
            for p, primitive in enumerate(mesh["primitives"]):
                if primitive.get("extensions", {}).pop("KHR_draco_mesh_compression", None):
                    found.add("KHR_draco_mesh_compression")
                    self._undraw(self._data.lists["meshes"][m].items("primitives")[p], primitive)
        self._drop_empty_buffers()
        for owner in (
            *self._of("bufferViews"),
            *(p for mesh in self._of("meshes") for p in mesh["primitives"]),
        ):
            if owner.get("extensions") == {}:
                del owner["extensions"]
        for key in ("extensionsUsed", "extensionsRequired"):
            left = [name for name in self.json.pop(key, []) if name not in found]
            if left:
                self.json[key] = left
        return tuple(sorted(found))

    def _drop_empty_buffers(self):
        """Buffers that stand only for what meshopt unfolds to: nothing is in them."""
        buffers, kept = self._of("buffers"), []
        for k, buffer in enumerate(buffers):
            empty = "EXT_meshopt_compression" in buffer.get("extensions", {})
            if not empty:
                for view in self._of("bufferViews"):
                    if view["buffer"] == k:
                        view["buffer"] = len(kept)
                kept.append(buffer)
        self.json["buffers"] = kept

    def _undraw(self, item, primitive):
        """Draco's indices and attributes as plain data of the types that their accessors have."""
        mesh, attributes = self._data.draco(item)
        accessors = self.json["accessors"]
        for semantic in attributes.value:
            if semantic not in primitive["attributes"]:
                continue
            at = accessors[primitive["attributes"][semantic]]
            data = self._data.drawn(item, semantic).astype(COMPONENTS[at["componentType"]])
            width = -data.shape[1] * data.dtype.itemsize % 4  # rows begin at multiples of 4
            rows = np.zeros((len(data), data.shape[1] + width // data.dtype.itemsize), data.dtype)
            rows[:, : data.shape[1]] = data
            at["bufferView"], at["byteOffset"] = self.view(rows, ARRAY), 0
            if "min" in at:  # what was packed is not exactly what was promised
                at |= bounds_of(data)
            if width:
                self.json["bufferViews"][at["bufferView"]]["byteStride"] = rows[0].nbytes
        index = np.asarray(mesh.faces, "<u4").ravel()
        if "indices" not in primitive:
            primitive["indices"] = self.append("accessors", {"count": len(index), "type": "SCALAR"})
        primitive["mode"] = 4  # a strip too is unpacked as triangles
        at = accessors[primitive["indices"]]
        at |= {"componentType": UINT, "bufferView": self.view(index, ELEMENTS), "byteOffset": 0}

    # --- writing ----------------------------------------------------------------------------------

    def _finish(self):
        """Names, weights at rest and old animations for the new number of targets."""
        if self._new:
            mesh = self.json["meshes"][self._mesh]
            owners = [o for o in (mesh, *mesh["primitives"]) if "targetNames" in _extras(o)]
            for owner in owners:
                owner["extras"]["targetNames"] = [*owner["extras"]["targetNames"], *self._new]
            if not owners:
                old = [name or f"target {k + 1}" for k, name in enumerate(self._names)]
                mesh["extras"] = {**_extras(mesh), "targetNames": [*old, *self._new]}
            nodes = self._of("nodes")
            moving = [k for k, node in enumerate(nodes) if node.get("mesh") == self._mesh]
            for owner in (mesh, *(nodes[k] for k in moving)):
                if "weights" in owner:
                    owner["weights"] = [*owner["weights"], *[0.0] * len(self._new)]
            self._widen(moving)
        if self._animation is not None:
            self.append("animations", self._animation)

    def _widen(self, moving):
        """Animations that were there before get the new targets, at rest."""
        data = self._data
        for told, animation in zip(self._of("animations"), data.lists["animations"], strict=True):
            samplers, ours, others = animation.items("samplers"), {}, set()
            for c, channel in enumerate(animation.items("channels")):
                target, k = channel.item("target"), channel.index("sampler", samplers)
                if target.text("path") == "weights" and target.value.get("node") in moving:
                    ours.setdefault(k, []).append(told["channels"][c])
                else:
                    others.add(k)
            for k, channels in ours.items():
                at = samplers[k].index("output", data.lists["accessors"])
                wide = {**told["samplers"][k], "output": self._wide(samplers[k], at)}
                if k not in others:
                    told["samplers"][k] = wide
                    continue
                told["samplers"].append(wide)  # other meshes move by the old one
                for channel in channels:
                    channel["sampler"] = len(told["samplers"]) - 1

    def _wide(self, sampler, at):
        """An accessor of weights with columns for the new targets."""
        rows, n = self._data.array(at, "SCALAR"), self.n_targets
        if len(rows) % n:
            raise sampler.damaged(
                f"has {len(rows)} weights, which are no rows of {n}, the number of morph targets",
                "output",
            )
        rows = np.pad(rows.reshape(-1, n), ((0, 0), (0, len(self._new))))
        return self.accessor(rows.ravel(), "SCALAR")

    def save(self, path):
        """Write the file, whole or not at all."""
        uris = [item.get("uri", "data:") for k in ("buffers", "images") for item in self._of(k)]
        beside = [uri for uri in uris if not uri.startswith("data:")]
        if beside and Path(path).resolve().parent != self._data.path.resolve().parent:
            raise ValueError(
                f"path={str(path)!r}: {self._data.path} keeps {beside[0]!r} beside it; write into "
                "the same folder, or make a GLB of it first."
            )
        self._finish()
        told, new = self.json, [v for v in self.json["bufferViews"] if v["buffer"] is None]
        buffers, body = told.setdefault("buffers", []), self._data.binary
        if body is None or not buffers or "uri" in buffers[0]:  # no buffer of the file's own
            text = base64.b64encode(self.added).decode()
            uri = f"data:application/octet-stream;base64,{text}"
            buffers.append({"byteLength": len(self.added), "uri": uri})
            for view in new:
                view["buffer"] = len(buffers) - 1
        else:
            body += bytes(-len(body) % 4)
            for view in new:
                view |= {"buffer": 0, "byteOffset": len(body) + view["byteOffset"]}
            body += self.added
            buffers[0]["byteLength"] = len(body)
        further = self._data.further
        data = json_text(told) if further is None else glb_bytes(told, body, further)
        with atomic_path(path) as part:
            part.write_bytes(data)


def _extras(owner):
    """What a program added to an object of the file; it may be anything."""
    extras = owner.get("extras")
    return extras if isinstance(extras, dict) else {}
