import json
import struct

import numpy as np
import pygltflib
import pytest
from planted import corner_regions
from shapes import grid_mesh, sphere_mesh

from facelab.files.gltf import write_clip_glb, write_glb
from facelab.geometry.mesh import TriangleMesh
from facelab.models.region import RegionModel
from facelab.posing.clips import Clip
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig

TYPES = {5126: np.dtype("<f4"), 5125: np.dtype("<u4")}
WIDTH = {"SCALAR": 1, "VEC3": 3}


class Reader:
    """A GLB read again, strictly: what the specification demands is asserted on the way."""

    def __init__(self, path):
        data = path.read_bytes()
        magic, version, length = struct.unpack("<4sII", data[:12])
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack("<I4s", data[12:20])
        assert kind == b"JSON" and size % 4 == 0
        self.json = json.loads(data[20 : 20 + size])
        rest = data[20 + size :]
        size, kind = struct.unpack("<I4s", rest[:8])
        assert kind == b"BIN\0" and size % 4 == 0 and len(rest) == 8 + size
        self.binary = rest[8:]
        self.gltf = pygltflib.GLTF2().load(str(path))
        assert 0 <= size - self.json["buffers"][0]["byteLength"] < 4
        used = []
        for view in self.json["bufferViews"]:
            start, n = view.get("byteOffset", 0), view["byteLength"]
            assert start % 4 == 0 and n > 0
            assert start + n <= self.json["buffers"][0]["byteLength"]
            used.append((start, start + n))
        assert all(a[1] <= b[0] for a, b in zip(sorted(used), sorted(used)[1:], strict=False))

    def view(self, index, dtype, count, offset=0, target=None):
        view = self.json["bufferViews"][index]
        assert view.get("target") == target and "byteStride" not in view
        start = view.get("byteOffset", 0) + offset
        assert offset + count * dtype.itemsize <= view["byteLength"]
        return np.frombuffer(self.binary, dtype, count, start)

    def array(self, index, target=None):
        at = self.json["accessors"][index]
        dtype, width = TYPES[at["componentType"]], WIDTH[at["type"]]
        assert at["count"] >= 1
        if "bufferView" in at:
            assert "sparse" not in at
            flat = self.view(at["bufferView"], dtype, width * at["count"], at["byteOffset"], target)
            out = flat.reshape(-1, width)
        else:
            assert "byteOffset" not in at, "not allowed without a buffer view"
            out = np.zeros((at["count"], width), dtype)
            sparse = at["sparse"]
            n = sparse["count"]
            assert 1 <= n <= at["count"]
            where = self.view(
                sparse["indices"]["bufferView"], TYPES[sparse["indices"]["componentType"]], n
            )
            assert (np.diff(where.astype(int)) > 0).all() and where[-1] < at["count"]
            out[where] = self.view(sparse["values"]["bufferView"], dtype, width * n).reshape(n, -1)
        for end, value in (("min", out.min(axis=0)), ("max", out.max(axis=0))):
            if end in at:
                np.testing.assert_array_equal(np.float32(at[end]), value)
        return out

    def mesh(self):
        """Vertices and displacements in millimetres, faces, names."""
        (mesh,) = self.json["meshes"]
        (part,) = mesh["primitives"]
        V = self.array(part["attributes"]["POSITION"], 34962)
        N = self.array(part["attributes"]["NORMAL"], 34962)
        np.testing.assert_allclose(np.linalg.norm(N, axis=1), 1, atol=1e-5)
        F = self.array(part["indices"], 34963).reshape(-1, 3)
        assert F.max() < len(V) and part["mode"] == 4
        deltas = []
        for target in part.get("targets", []):
            at = self.json["accessors"][target["POSITION"]]
            assert "min" in at and "max" in at and at["count"] == len(V)
            dense = 34962 if "bufferView" in at else None
            deltas.append(1e3 * self.array(target["POSITION"], dense).astype(float))
        names = mesh.get("extras", {}).get("targetNames", [])
        assert len(names) == len(deltas) == len(mesh.get("weights", []))
        return 1e3 * V.astype(float), np.array(deltas), F, names

    def animation(self):
        """Times, values (n_keys, [3,] n_targets) and interpolation."""
        (animation,) = self.json["animations"]
        (channel,), (sampler,) = animation["channels"], animation["samplers"]
        assert channel["target"] == {"node": 0, "path": "weights"} and channel["sampler"] == 0
        assert self.json["nodes"][0]["mesh"] == 0 and self.json["scenes"][0]["nodes"] == [0]
        moment = self.json["accessors"][sampler["input"]]
        assert "min" in moment and "max" in moment
        times = self.array(sampler["input"])[:, 0]
        assert times[0] >= 0 and (np.diff(times) > 0).all()
        shape = [len(times), len(self.mesh()[3])]
        if sampler["interpolation"] == "CUBICSPLINE":
            shape.insert(1, 3)
        return times, self.array(sampler["output"]).reshape(shape), sampler["interpolation"]

    def at(self, seconds):
        """The animated vertices, by the interpolation that the specification writes down."""
        V, deltas, _, _ = self.mesh()
        times, values, way = self.animation()
        k = np.clip(np.searchsorted(times, seconds, side="right") - 1, 0, len(times) - 1)
        after = min(k + 1, len(times) - 1)
        gap = times[after] - times[k]
        s = 0 if gap == 0 else min((seconds - times[k]) / gap, 1)
        if way == "CUBICSPLINE":
            w = (2 * s**3 - 3 * s**2 + 1) * values[k, 1] + gap * (s**3 - 2 * s**2 + s) * values[
                k, 2
            ]
            w = (
                w
                + (3 * s**2 - 2 * s**3) * values[after, 1]
                + gap * (s**3 - s**2) * values[after, 0]
            )
        else:
            w = (1 - s) * values[k] + s * values[after] if way == "LINEAR" else values[k]
        return V + np.tensordot(w, deltas, axes=1)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "face.glb"


@pytest.fixture
def face():
    """A sphere in millimetres, larger than a face: float32 metres hold it to 1e-5 mm."""
    return sphere_mesh(2, 100.0)


def test_a_face_alone_keeps_its_vertices_their_order_and_its_triangles(path, face):
    write_glb(path, face)
    V, deltas, F, names = Reader(path).mesh()
    np.testing.assert_allclose(V, face.vertices, atol=1e-4)
    np.testing.assert_array_equal(F, face.faces)
    assert len(deltas) == 0 and names == []
    assert "animations" not in Reader(path).json


def targets(face, rng):
    """Everywhere, in a few places, in one, nowhere."""
    deltas = np.zeros((4, face.n_vertices, 3))
    deltas[0] = rng.normal(size=deltas[0].shape)
    deltas[1, 5:25] = rng.normal(size=(20, 3))
    deltas[2, 161] = [1.0, 2, 3]
    return deltas


def test_targets_and_their_names_are_kept_sparse_or_dense(path, face, rng):
    deltas, names = targets(face, rng), ["jawOpen", "eyeBlink_L", "Grübchen", "none"]
    write_glb(path, face, deltas, names)
    reader = Reader(path)
    _, found, _, kept = reader.mesh()
    np.testing.assert_allclose(found, deltas, atol=1e-6)
    assert kept == names
    sparse = ["sparse" in a for a in reader.json["accessors"]]
    assert sum(sparse) == 3


def test_pygltflib_reads_the_same_names_and_counts(path, face, rng):
    write_glb(path, face, targets(face, rng), list("abcd"), [0, 1], rng.uniform(size=(2, 4)))
    gltf = Reader(path).gltf
    assert gltf.meshes[0].extras["targetNames"] == list("abcd")
    assert len(gltf.meshes[0].primitives[0].targets) == 4
    assert gltf.asset.version == "2.0"


@pytest.mark.parametrize("way", ["LINEAR", "STEP", "SMOOTH"])
def test_an_animation_goes_through_its_keys(path, face, rng, way):
    deltas, W, times = targets(face, rng), rng.uniform(size=(3, 4)), np.array([0, 0.5, 2])
    write_glb(path, face, deltas, None, times, W, way)
    reader = Reader(path)
    for t, w in zip(times, W, strict=True):
        expected = face.vertices + np.tensordot(w, deltas, axes=1)
        np.testing.assert_allclose(reader.at(t), expected, atol=1e-4)
    s = {"LINEAR": 0.25, "STEP": 0, "SMOOTH": 3 * 0.25**2 - 2 * 0.25**3}[way]
    w = (1 - s) * W[1] + s * W[2]
    np.testing.assert_allclose(
        reader.at(0.875), face.vertices + np.tensordot(w, deltas, axes=1), atol=1e-4
    )


@pytest.mark.parametrize("easing", ["smooth", "linear"])
@pytest.mark.parametrize("kind", ["model", "rig"])
def test_a_clip_moves_in_the_file_as_it_does_in_the_session(path, rng, kind, easing):
    regions = corner_regions()
    if kind == "rig":
        deltas = rng.normal(size=(5, 42, 3))
        model = BlendshapeRig(regions.mesh, ["jawOpen", "b", "c", "d", "e"], deltas)
        poses = rng.uniform(0, 1, size=(3, 5))
    else:
        model = RegionModel(regions, 5).fit(rng.normal(size=(50, 126)))
        poses = 3 * rng.normal(size=(3, 20))
    session = PosingSession(model, regions.mesh)
    clip = Clip([0, 0.75, 1.5], poses, easing, ["smile", "frown", "smile"])
    write_clip_glb(path, clip, session)
    reader = Reader(path)
    for t in [*clip.times, 0.2, 0.5, 1.1]:
        expected = session.vertices_of(clip.at(t))
        np.testing.assert_allclose(reader.at(t), expected, atol=1e-4)  # the promise
    names = reader.mesh()[3]
    assert names == (
        ["jawOpen", "b", "c", "d", "e"] if kind == "rig" else ["smile", "frown", "smile (2)"]
    )


@pytest.mark.real
def test_a_clip_of_the_real_rig_keeps_its_53_names_and_every_key_frame(path, rng, real_rig):
    session = PosingSession(real_rig, real_rig.neutral)
    few = rng.uniform(size=(4, 53)) * (rng.uniform(size=(4, 53)) < 0.2)
    clip = Clip([0, 0.5, 1.5, 2], few)
    write_clip_glb(path, clip, session)
    reader = Reader(path)
    assert tuple(reader.mesh()[3]) == real_rig.names
    for t in clip.times:
        np.testing.assert_allclose(reader.at(t), session.vertices_of(clip.at(t)), atol=1e-4)


def test_a_triangle_without_area_still_has_a_normal(path):
    V = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 5, 0], [9, 9, 9], [9, 9, 9], [9, 9, 9.0]])
    write_glb(path, TriangleMesh(V, [[0, 1, 2], [0, 1, 3], [4, 5, 6]]))
    Reader(path).mesh()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(deltas=np.zeros((2, 11, 3))), r"deltas has shape \(2, 11, 3\)"),
        (dict(deltas=np.full((1, 12, 3), np.nan)), "NaN"),
        (dict(deltas=np.zeros((2, 12, 3)), names=["a"]), "names has 1 entries"),
        (dict(deltas=np.zeros((2, 12, 3)), names=["a", "a"]), "names holds a more than once"),
        (dict(deltas=np.zeros((2, 12, 3)), times=[0.0]), "belong together"),
        (dict(deltas=np.zeros((1, 12, 3)), times=[0, 1], weights=[[0, 1]]), "weights has shape"),
        (dict(deltas=np.zeros((1, 12, 3)), times=[1, 0], weights=[[0], [1]]), "ascend"),
        (dict(deltas=np.zeros((1, 12, 3)), times=[-1, 0], weights=[[0], [1]]), "ascend"),
        (dict(deltas=np.zeros((1, 12, 3)), times=[1, 1 + 1e-12], weights=[[0], [1]]), "ascend"),
        (dict(times=[0.0], weights=np.zeros((1, 0))), "no deltas"),
        (dict(interpolation="CUBIC"), "interpolation='CUBIC'"),
    ],
)
def test_what_cannot_be_written_is_refused_and_nothing_is_written(path, arguments, message):
    with pytest.raises(ValueError, match=message):
        write_glb(path, grid_mesh(4, 3), **arguments)
    assert not path.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (lambda path: (path, np.zeros((12, 3))), "mesh is a ndarray; give a TriangleMesh"),
        (lambda path: (None, grid_mesh(4, 3)), "path is a NoneType; give a str or a Path"),
    ],
)
def test_what_is_no_mesh_or_no_path_is_called_so(path, arguments, message):
    with pytest.raises(TypeError, match=message):
        write_glb(*arguments(path))
    assert not path.exists()


def test_a_face_in_metres_is_noticed_before_it_shrinks_to_a_speck(path, face):
    with pytest.warns(UserWarning, match="mesh: its longest side .* metres: multiply .* by 1000"):
        write_glb(path, face.with_vertices(face.vertices / np.ptp(face.vertices) / 5))


def test_the_other_programs_see_metres(path, face):
    write_glb(path, face)
    at = Reader(path).json["accessors"][0]
    np.testing.assert_allclose(at["max"], face.vertices.max(axis=0) / 1000, atol=1e-7)
