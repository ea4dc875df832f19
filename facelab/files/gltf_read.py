"""Meshes and morph targets of glTF files, placed as the scene places them.

References
----------
Khronos Group, glTF 2.0 specification, sections 3.5 (scenes) and 3.7 (meshes, skins).
"""

import warnings
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from facelab.files.gltf_data import GltfData
from facelab.files.gltf_texture import texture_of
from facelab.files.parts import LONGEST, MeshFile, check_coordinates
from facelab.files.pictures import or_left_out
from facelab.files.words import damaged, distinct, listed, quoted
from facelab.geometry.texture import Texture

_SEMANTICS = ("POSITION", "NORMAL", "TANGENT", "TEXCOORD_", "COLOR_", "JOINTS_", "WEIGHTS_", "_")
_PRIMITIVE = ("attributes", "indices", "material", "mode", "targets")


@dataclass(frozen=True, eq=False)
class GltfPart:
    """A mesh where a node of the scene places it.

    Parameters
    ----------
    name : str
        Of the node, or of the mesh; numbered where several have the same.
    vertices : ndarray of shape (n_vertices, 3)
        Metres, the vertices of all primitives one after the other.
    faces : ndarray of int, shape (n_faces, 3)
    names : list of str
        Of the morph targets, as the file has them; empty strings where it names none.
    deltas : ndarray of float32, shape (n_targets, n_vertices, 3)
        Their displacements, metres; no targets where they were not asked for.
    linear : ndarray of shape (3, 3) or (n_vertices, 3, 3)
        What turned the file's displacements into these.
    start : dict of int to int
        First vertex of each primitive; those that share their vertices share it.
    texture : Texture or None
        If it was asked for, and the file has one.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    names: list
    deltas: np.ndarray
    linear: np.ndarray
    start: dict = field(default_factory=dict)
    texture: Texture | None = None


class GltfScene:
    """The meshes of a glTF or GLB file.

    Parameters
    ----------
    path : str or Path

    Attributes
    ----------
    names : list of str
        Of the parts, in the order of the scene.
    data : GltfData

    Raises
    ------
    FileNotFoundError, ValueError
        For a file that cannot be read, a hierarchy that is no tree, or no meshes.
    """

    def __init__(self, path):
        self.data = GltfData(path)
        self.path = self.data.path
        self._matrices, placed = self._walk()
        nodes, meshes = self.data.lists["nodes"], self.data.lists["meshes"]
        found = []  # node (None where there are no nodes at all), mesh, its two names
        for node in placed:
            if "mesh" in nodes[node]:
                mesh = nodes[node].index("mesh", meshes)
                found.append((node, mesh, nodes[node].text("name"), meshes[mesh].text("name")))
        if not nodes:
            found = [(None, k, m.text("name"), None) for k, m in enumerate(meshes)]
        found = self._usable(found)
        if not found:
            raise ValueError(
                f"{self.path}: no mesh in its scene; export the file again with the face in it."
            )
        self._found = found
        self._aliases = [name for _, _, _, name in found]
        self.names = distinct(
            [own or other or f"mesh {k}" for k, (_, _, own, other) in enumerate(found)]
        )

    def _usable(self, found):
        """The parts that have triangles and a size; the others are said."""
        kept, passed = [], []
        for node, mesh, own, other in found:
            item = self.data.lists["meshes"][mesh]
            flat = node is not None and np.linalg.det(self._matrices[node][:3, :3]) == 0
            flat = flat and "skin" not in self.data.lists["nodes"][node]  # joints place it
            if flat or all(p.whole("mode", 4, high=6) < 4 for p in item.items("primitives")):
                passed.append(own or other or item.place)
            else:
                kept.append((node, mesh, own, other))
        if passed:
            warnings.warn(
                f"{self.path}: {quoted(passed)} ({len(passed)}) have no triangles, or are scaled "
                "to nothing, and are passed over.",
                stacklevel=3,
            )
        return kept

    def find(self, name):
        """Number of the part with that name: its node's, or else its mesh's.

        Raises
        ------
        ValueError
            If there is none, or more than one mesh, of that name; with those there are.
        """
        if name in self.names:
            return self.names.index(name)
        known = [k for k, alias in enumerate(self._aliases) if alias == name and name]
        if len(known) == 1:
            return known[0]
        raise ValueError(
            f"{self.path}: mesh={name!r} is not in it; its parts are {quoted(self.names, 20)}."
        )

    def place(self, k):
        """Indices of part k's node (None in a file without nodes) and mesh."""
        return self._found[k][:2]

    def n_targets(self, k):
        """Number of morph targets of part k."""
        primitives = self.data.lists["meshes"][self._found[k][1]].items("primitives")
        return max([len(p.items("targets")) for p in primitives], default=0)

    # --- nodes ------------------------------------------------------------------------------------

    def _walk(self):
        """The matrix of every node that the scene holds, and those nodes in their order."""
        nodes = self.data.lists["nodes"]
        children = [n.wholes("children", nodes) for n in nodes]
        scenes = self.data.lists["scenes"]
        if scenes:
            first = self.data.json.whole("scene", 0, high=len(scenes) - 1)
            roots = scenes[first].wholes("nodes", nodes)
        else:
            roots = sorted(set(range(len(nodes))) - {c for cs in children for c in cs})
        matrices, order = {}, []
        stack = [(root, self._upright()) for root in reversed(roots)]
        while stack:
            node, above = stack.pop()
            if node in matrices:
                raise ValueError(
                    f"{self.path}: nodes[{node}] hangs below two nodes or below itself; the "
                    "hierarchy has to be a tree. Export the file again."
                )
            matrices[node] = above @ self._matrix(nodes[node])
            if not np.isfinite(matrices[node]).all():
                raise ValueError(f"{self.path}: nodes[{node}] is placed beyond all numbers.")
            order.append(node)
            stack += [(child, matrices[node]) for child in reversed(children[node])]
        return matrices, order

    def _upright(self):
        """VRM 0 faces away from the viewer, all other glTF towards them."""
        turned = "VRM" in self.data.json.item("extensions")
        return np.diag([-1.0, 1, -1, 1]) if turned else np.eye(4)

    def _matrix(self, node):
        if "matrix" in node:
            return np.array(node.numbers("matrix", 16)).reshape(4, 4).T
        turn = np.array(node.numbers("rotation", 4, [0.0, 0, 0, 1]))  # x, y, z, w
        if not 0.98 < turn @ turn < 1.02:
            raise node.wrong("rotation", "a quaternion of length 1")
        M = np.eye(4)
        M[:3, :3] = Rotation.from_quat(turn).as_matrix() * node.numbers("scale", 3, [1.0, 1, 1])
        M[:3, 3] = node.numbers("translation", 3, [0.0, 0, 0])
        return M

    def _placement(self, node, joints, weights):
        """What moves a part's vertices to their place: (4, 4), or (n_vertices, 4, 4) by a skin."""
        nodes = self.data.lists["nodes"]
        if node is None:
            return self._upright()
        if "skin" not in nodes[node]:
            return self._matrices[node]
        # a skin's vertices follow its joints, and its node's own place counts for nothing
        skin = self.data.lists["skins"][nodes[node].index("skin", self.data.lists["skins"])]
        bones = skin.wholes("joints", nodes)
        if joints is None or not bones:
            return self._matrices[node]
        outside = [b for b in bones if b not in self._matrices]
        if outside:
            raise skin.damaged(f"has the joint {outside[0]}, which is not in the scene")
        M = np.stack([self._matrices[b] for b in bones])
        if "inverseBindMatrices" in skin:
            accessors = self.data.lists["accessors"]
            index = skin.index("inverseBindMatrices", accessors)
            bind = self.data.array(index, "MAT4").astype(float).reshape(-1, 4, 4)
            if len(bind) < len(bones):
                raise skin.damaged(
                    f"has {len(bones)} joints, but {len(bind)} inverse bind matrices"
                )
            M = M @ bind.transpose(0, 2, 1)[: len(bones)]
        used = joints[weights > 0]
        if used.size and used.max() >= len(bones):
            raise damaged(
                f"{self.path}: a vertex follows joint {used.max()}, but {skin.place} has "
                f"{len(bones)}"
            )
        joints = np.where(weights > 0, joints, 0)
        weights[weights.sum(axis=1) <= 0, 0] = 1  # tied to nothing: the first joint carries it
        share = weights / weights.sum(axis=1, keepdims=True)
        placed = np.zeros((len(joints), 4, 4))
        for column in range(joints.shape[1]):
            placed += share[:, column, None, None] * M[joints[:, column]]
        return placed

    # --- parts ------------------------------------------------------------------------------------

    def part(self, k, shapes=False, texture=False):
        """Part k as a `GltfPart`, with its morph targets and texture if they are asked for.

        Raises
        ------
        ValueError
            For data that are damaged or do not agree, naming their place in the file.
        """
        data = self.data
        node, mesh, _, _ = self._found[k]
        item = data.lists["meshes"][mesh]
        primitives = item.items("primitives")
        kept, faces, start, starts, n = [], [], {}, {}, 0
        for i, primitive in enumerate(primitives):
            primitive.warn_unknown(_PRIMITIVE)
            if primitive.whole("mode", 4, high=6) >= 4:
                own = self._vertices(primitive, shapes)
                key = own.pop("key")
                if key is None or key not in starts:  # primitives may share all their vertices
                    kept.append(own)
                    starts[key] = n
                    n += len(own["V"])
                start[i] = starts[key]
                faces.append(self._faces(primitive, starts[key], len(own["V"])))
        picture = None
        if texture:
            own = [F - begin for F, begin in zip(faces, start.values(), strict=True)]
            picture = or_left_out(texture_of, data, [primitives[i] for i in start], own)
        names = self._target_names(item, primitives)
        data.need(200 * n + 24 * sum(map(len, faces)), f"{self.names[k]!r}")
        V = np.vstack([own["V"] for own in kept]).astype(float)
        joints, weights = self._joints(kept)
        M = self._placement(node, joints, weights)
        linear, shift = M[..., :3, :3], M[..., :3, 3]
        sides = np.linalg.det(linear.reshape(-1, 3, 3))
        if (sides == 0).any() or (sides.min() < 0 < sides.max()):
            raise ValueError(
                f"{self.path}: {self.names[k]!r} is squashed flat or turned inside out where the "
                "scene places it; apply its scale in the program that made it."
            )
        V = np.einsum("...ij,...j->...i", linear, V) + shift
        check_coordinates(V, lambda row: f"{self.path}: {self.names[k]!r}, vertex {row}")
        F = np.vstack(faces)
        if sides.flat[0] < 0:
            F = F[:, ::-1]
            if picture is not None:
                picture = Texture(picture.image, picture.uv[:, ::-1])
        deltas = np.empty((0, len(V), 3), np.float32)
        if shapes and names:
            deltas = self._deltas(kept, len(names), len(V), linear, self.names[k])
        return GltfPart(self.names[k], V, F, names, deltas, linear, start, picture)

    def _vertices(self, primitive, shapes):
        """Positions, joints and targets of one primitive, as the file has them."""
        data, accessors = self.data, self.data.lists["accessors"]
        attributes = primitive.item("attributes")
        odd = [a for a in attributes.value if not a.startswith(_SEMANTICS)]
        targets = primitive.items("targets")
        odd += [a for t in targets for a in t.value if not a.startswith((*_SEMANTICS, "extra"))]
        if odd:
            warnings.warn(
                f"{self.path}: {primitive.place} has the attribute {odd[0]!r}, which glTF does not "
                "know; it is passed over.",
                stacklevel=2,
            )
        index = attributes.index("POSITION", accessors)
        count = data.count(index)

        V = data.attribute(primitive, "POSITION", "VEC3")
        none = np.zeros((count, 0))
        joints, weights, n = [none], [none], 0
        while f"JOINTS_{n}" in attributes and f"WEIGHTS_{n}" in attributes:
            joints.append(data.attribute(primitive, f"JOINTS_{n}", "VEC4", wholes=True))
            weights.append(data.attribute(primitive, f"WEIGHTS_{n}", "VEC4"))
            if not (weights[-1] >= 0).all():  # neither NaN
                raise attributes.damaged(
                    "holds weights that are negative or no numbers", f"WEIGHTS_{n}"
                )
            n += 1
        at = [t.index("POSITION", accessors) if "POSITION" in t else None for t in targets]
        for t, a in zip(targets, at, strict=True):
            if a is not None and data.count(a) != count:
                raise t.damaged(
                    f"has {data.count(a)} elements, but the mesh {count} vertices", "POSITION"
                )
        ties = tuple(attributes.value.get(f"JOINTS_{i}") for i in range(n))
        return {
            "key": None if data.draco(primitive) else (index, tuple(at), ties),
            "V": V,
            "joints": np.hstack(joints).astype(np.int64),
            "weights": np.hstack(weights),
            "targets": at if shapes else [],
        }

    def _joints(self, kept):
        """Joints and weights of all vertices; None where no primitive has them."""
        width = max(own["joints"].shape[1] for own in kept)
        if not width:
            return None, None
        return [
            np.vstack([np.pad(own[w], ((0, 0), (0, width - own[w].shape[1]))) for own in kept])
            for w in ("joints", "weights")
        ]

    def _faces(self, primitive, begin, count):
        """Triangles of one primitive, numbered from `begin`."""
        accessors = self.data.lists["accessors"]
        mode, packed = primitive.whole("mode", 4, high=6), self.data.draco(primitive)
        if packed:
            index = np.asarray(packed[0].faces, dtype=np.int64).ravel()
            if "indices" in primitive:
                promised = self.data.count(primitive.index("indices", accessors))
                if promised != len(index):
                    raise primitive.damaged(
                        f"has Draco data of {len(index)} indices, but promises {promised}"
                    )
            mode = 4
        elif "indices" in primitive:
            index = self.data.array(primitive.index("indices", accessors), "SCALAR", wholes=True)
            index = index.astype(np.int64)
        else:
            index = np.arange(count)
        if len(index) and index.max() >= count:
            raise primitive.damaged(
                f"names vertex {index.max()}, but has {count}: 0 to {count - 1}"
            )
        if len(index) < 3 or (mode == 4 and len(index) % 3):
            raise primitive.damaged(f"has {len(index)} indices, which make no triangles")
        if mode == 4:
            F = index.reshape(-1, 3)
        elif mode == 5:
            F = np.stack([index[:-2], index[1:-1], index[2:]], axis=1)
            F[1::2] = F[1::2][:, [1, 0, 2]]
        else:
            F = np.stack([np.full(len(index) - 2, index[0]), index[1:-1], index[2:]], axis=1)
        flat = (F == np.roll(F, 1, axis=1)).any(axis=1)
        if mode == 4 and flat.any():
            warnings.warn(
                f"{self.path}: {primitive.place}: {int(flat.sum())} of {len(F)} triangles use a "
                "vertex twice; they have no area and are left out.",
                stacklevel=2,
            )
        return F[~flat] + begin

    def _target_names(self, mesh, primitives):
        """Names of the morph targets, empty strings where the file has none."""
        counts = {len(p.items("targets")) for p in primitives}
        if len(counts) > 1:
            raise ValueError(
                f"{self.path}: the primitives of {mesh.place} have {sorted(counts)} morph targets; "
                "each needs the same. Export the file again."
            )
        n = max(counts, default=0)
        told = []  # of the mesh, and of each primitive
        for owner in (mesh, *primitives):
            extras = owner.value.get("extras")
            if isinstance(extras, dict) and "targetNames" in extras:
                names = owner.item("extras").texts("targetNames")
                if len(names) != n:
                    raise owner.damaged(
                        f"has {len(names)} names, but the mesh {n} morph targets",
                        "extras.targetNames",
                    )
                told.append((owner, list(names)))
        told += [(p, [_name_of(t) for t in p.items("targets")]) for p in primitives]
        told = [(owner, names) for owner, names in told if any(names)]
        for owner, names in told[1:]:
            first, others = told[0][1], sorted(told[0][1])
            if names != first and sorted(names) == others:
                k = next(k for k in range(n) if names[k] != first[k])
                raise ValueError(
                    f"{self.path}: morph target {k} is {first[k]!r} in {told[0][0].place}, but "
                    f"{names[k]!r} in {owner.place}; all need one order. Export the file again."
                )
        return told[0][1] if told else self._stored_names(primitives, n)

    def _stored_names(self, primitives, n):
        """Names of the data of the morph targets, which some converters write in place of theirs.

        Empty strings where the primitives do not agree on them, or one is there twice.
        """
        accessors, found = self.data.lists["accessors"], []
        for primitive in primitives:
            targets = [t for t in primitive.items("targets") if "POSITION" in t]
            found.append([accessors[t.index("POSITION", accessors)].text("name") for t in targets])
        first = found[0] if found else []
        agreed = len(set(first)) == n and None not in first and all(f == first for f in found)
        return first if agreed else [""] * n

    def weights_at_rest(self, k, names):
        """What the file shows of part k's morph targets before anything moves: dict of weights."""
        node, mesh, _, _ = self._found[k]
        owners = [] if node is None else [self.data.lists["nodes"][node]]
        for owner in (*owners, self.data.lists["meshes"][mesh]):
            if "weights" in owner:
                told = owner.numbers("weights", len(names))
                return {n: w for n, w in zip(names, told, strict=True) if w}
        return {}

    def _deltas(self, kept, n_targets, n_vertices, linear, name):
        """Displacements of all targets, turned and scaled as the mesh is."""
        self.data.need(12 * n_targets * n_vertices, f"the {n_targets} shapes of {name!r}")
        deltas = np.zeros((n_targets, n_vertices, 3), np.float32)
        begin = 0
        for own in kept:
            end = begin + len(own["V"])
            for k, at in enumerate(own["targets"]):
                if at is not None:
                    deltas[k, begin:end] = self.data.array(at, "VEC3")
            begin = end
        for k, delta in enumerate(deltas):
            moved = np.einsum("...ij,...j->...i", linear, delta.astype(float))
            if not (np.abs(moved) < LONGEST).all():
                raise damaged(
                    f"{self.path}: morph target {k} of {name!r} holds NaN, infinity or a number "
                    f"beyond {LONGEST:g}"
                )
            deltas[k] = moved
        return deltas


def _name_of(target):
    """The name that old exporters of avatars give a morph target itself, or none."""
    told = [target.value.get(key) for key in ("extras", "extra")]
    found = [t["name"] for t in told if isinstance(t, dict) and isinstance(t.get("name"), str)]
    return found[0] if found else ""


def read_gltf_file(path, mesh=None):
    """All parts of a glTF or GLB file, or one, as a `MeshFile`, in metres.

    Morph targets are left out, and named in a warning.
    """
    scene = GltfScene(path)
    chosen = range(len(scene.names)) if mesh is None else [scene.find(mesh)]
    parts = [scene.part(k, texture=len(chosen) == 1) for k in chosen]
    shapes = [f"{scene.n_targets(k)} of {scene.names[k]!r}" for k in chosen if scene.n_targets(k)]
    if shapes:
        warnings.warn(
            f"{scene.path}: morph targets are left out ({listed(shapes)}); "
            "facelab.read_rig reads them.",
            stacklevel=4,
        )
    start = np.cumsum([0] + [len(p.vertices) for p in parts])
    faces = np.cumsum([0] + [len(p.faces) for p in parts])
    return MeshFile(
        scene.path,
        np.vstack([p.vertices for p in parts]),
        np.vstack([p.faces + s for p, s in zip(parts, start, strict=False)]),
        {p.name: np.arange(faces[k], faces[k + 1]) for k, p in enumerate(parts)},
        {p.name: np.arange(start[k], start[k + 1]) for k, p in enumerate(parts)},
        parts[0].texture,  # of one part alone
    )
