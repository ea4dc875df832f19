import base64
import json
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from mutants import COUNT, tally
from scipy.spatial.transform import Rotation
from shapes import sphere_mesh

from facelab.files import read_mesh, read_rig, write_glb, write_into, write_obj, write_rig
from facelab.geometry.mesh import TriangleMesh
from facelab.rig import BlendshapeRig

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"


@pytest.fixture
def rig(rng):
    """A ball of a head's size with three shapes that move its front."""
    mesh = sphere_mesh(2, radius=100.0)
    near = np.maximum(0, mesh.vertices[:, 2] / 100)
    deltas = near[None, :, None] * rng.normal(scale=5, size=(3, 1, 3))
    names = ["jawOpen", "browInnerUp", "mouthSmileLeft"]
    return BlendshapeRig(TriangleMesh(mesh.vertices, mesh.faces, {"chin": 4}), names, deltas)


def write_folder(folder, rig, scale=1.0, rest="neutral"):
    folder.mkdir(exist_ok=True)
    shapes = {rest: rig.neutral.vertices}
    shapes |= {n: rig.neutral.vertices + d for n, d in zip(rig.names, rig.deltas, strict=True)}
    for name, V in shapes.items():
        write_obj(folder / f"{name}.obj", TriangleMesh(V * scale, rig.neutral.faces))
    return folder


def silently(read, *args, **kwargs):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read(*args, **kwargs)


# --- GLB ------------------------------------------------------------------------------------------


def test_a_rig_written_as_glb_comes_back_in_millimetres_with_its_names(tmp_path, rig):
    write_glb(tmp_path / "head.glb", rig.neutral, rig.deltas, rig.names)
    again = silently(read_rig, tmp_path / "head.glb")
    assert again.names == rig.names
    np.testing.assert_allclose(again.neutral.vertices, rig.neutral.vertices, atol=1e-5)
    np.testing.assert_allclose(again.deltas, rig.deltas, atol=2e-6)  # less is left out when written
    np.testing.assert_array_equal(again.neutral.faces, rig.neutral.faces)
    assert (again.source.mesh, again.source.scale, again.parts) == ("face", 1000, {})
    assert again.source.index.tolist() == list(range(rig.neutral.n_vertices))


@pytest.mark.parametrize("name", ["avatar", "avatar_quantised", "avatar_sparse", "avatar_meshopt"])
def test_an_avatar_becomes_a_rig_with_its_seam_closed_and_its_parts_by_name(name):
    rig = silently(read_rig, FIXTURES / f"{name}.glb")
    assert rig.names == ("jawOpen", "eyeBlinkLeft", "mouthSmileRight", "browInnerUp")
    assert rig.source.mesh == "Head"
    assert rig.neutral.n_vertices == 11 * 16 + 2  # a ball of 13 rings, its poles are points
    assert not rig.neutral.boundary_loops and rig.neutral.pieces.max() == 0
    np.testing.assert_allclose(np.ptp(rig.neutral.vertices, axis=0), [150, 220, 180], atol=0.3)
    assert list(rig.parts) == ["Teeth", "EyeLeft"]
    teeth, eye = rig.parts.values()
    assert teeth.names == ("jawOpen",) and isinstance(eye, TriangleMesh)
    assert np.ptp(eye.vertices, axis=0).max() == pytest.approx(24, abs=0.01)


def test_the_index_map_leads_from_the_file_to_the_rig():
    with pytest.warns(UserWarning, match="morph targets are left out"):
        held = read_mesh(FIXTURES / "avatar.glb", mesh="Head")
    rig = read_rig(FIXTURES / "avatar.glb")
    assert len(rig.source.index) == held.n_vertices
    back = rig.neutral.vertices[rig.source.index]
    assert np.abs(back - held.vertices).max() < 1e-3  # a seam is closed over less than that


def test_the_part_to_read_is_chosen_by_name():
    rig = read_rig(FIXTURES / "avatar.glb", mesh="TeethMesh")
    assert (rig.names, list(rig.parts)) == (("jawOpen",), ["Head", "EyeLeft"])
    with pytest.raises(ValueError, match="mesh='Nose' is not in it; its parts are 'Teeth', 'Head'"):
        read_rig(FIXTURES / "avatar.glb", mesh="Nose")
    with pytest.raises(
        ValueError, match="mesh='EyeLeft' has no morph targets; those with some are"
    ):
        read_rig(FIXTURES / "avatar.glb", mesh="EyeLeft")


def test_lips_that_touch_stay_apart_and_seams_close(tmp_path):
    """Two strips that share an edge three times: as a seam, and as lips that move apart."""
    V = np.array([[x, y, 0.0] for y in (0, 100, 100, 100, 200) for x in (0, 50, 100)])
    V[12:] += [0, 0, 0]
    low, high = [0, 1, 2, 3, 4, 5], [9, 10, 11, 12, 13, 14]
    F = [[a[k], a[k + 1], a[k + 3]] for a in (low, high) for k in (0, 1)]
    F += [[a[k + 1], a[k + 4], a[k + 3]] for a in (low, high) for k in (0, 1)]
    mesh = TriangleMesh(np.delete(V, [6, 7, 8], axis=0), np.array(F) - 3 * (np.array(F) > 8))
    deltas = np.zeros((1, 12, 3))
    deltas[0, 6:, 1] = 20  # the upper strip rises
    deltas[0, [3, 4], 1] = [20, 0]  # of the lower one, one end goes along: there it is a seam
    write_glb(tmp_path / "lips.glb", mesh, deltas, ["mouthOpen"])
    rig = read_rig(tmp_path / "lips.glb")
    assert rig.neutral.n_vertices == 11
    assert rig.source.index[3] == rig.source.index[6]
    assert rig.source.apart == 2


def test_a_seam_in_coarse_coordinates_closes_and_a_narrow_strip_stays(tmp_path, rig, rng):
    """As of two materials that Draco compressed, each on a grid of its own."""
    V, F, n = rig.neutral.vertices, rig.neutral.faces, rig.neutral.n_vertices
    left = V[F].mean(axis=1)[:, 0] > 0
    seam = np.intersect1d(F[left], F[~left])
    new = np.arange(n)
    new[seam] = n + np.arange(len(seam))
    F = np.vstack([np.where(left[:, None], new[F], F), n + len(seam) + np.array([[0, 1, 2]])])
    strip = V[4] + [[0, 0, 50], [0, 9, 50], [0.03, 9, 50]]
    cut = np.vstack([V, V[seam] + rng.uniform(-0.02, 0.02, (len(seam), 3)), strip])
    deltas = np.hstack([rig.deltas, rig.deltas[:, seam], np.zeros((3, 3, 3))])
    write_glb(tmp_path / "cut.glb", TriangleMesh(cut, F), deltas, rig.names)
    again = read_rig(tmp_path / "cut.glb")
    assert again.neutral.n_vertices == n + 3 and len(again.neutral.faces) == len(F)
    np.testing.assert_array_equal(again.source.index[seam], again.source.index[n : n + len(seam)])
    write_into(tmp_path / "more.glb", again, {"more": again.deltas[0]})


def test_a_tuft_of_hair_within_less_than_a_seam_is_read_as_it_is(tmp_path, rig, rng):
    """Cards whose roots all lie in nearly one place."""
    V, n = rig.neutral.vertices, rig.neutral.n_vertices
    cards = V[4] + rng.uniform(-0.025, 0.025, (60, 3)) + [[0, 0, 50]]
    F = np.vstack([rig.neutral.faces, n + np.arange(60).reshape(-1, 3)])
    mesh = TriangleMesh(np.vstack([V, cards]), F)
    write_glb(tmp_path / "tuft.glb", mesh, np.pad(rig.deltas, ((0, 0), (0, 60), (0, 0))), rig.names)
    assert read_rig(tmp_path / "tuft.glb").neutral.n_vertices == n + 60


def test_shapes_without_names_are_numbered_and_said(tmp_path, rig):
    write_glb(tmp_path / "a.glb", rig.neutral, rig.deltas, ["", "x", "y"])
    with pytest.warns(UserWarning, match=r"1 morph target\(s\) of 'face' have no name.*target 1"):
        assert read_rig(tmp_path / "a.glb").names == ("target 1", "x", "y")


def test_a_file_without_shapes_is_refused_with_what_to_do(tmp_path, rig):
    write_glb(tmp_path / "a.glb", rig.neutral)
    with pytest.raises(ValueError, match="no morph targets in it; export it with shape keys"):
        read_rig(tmp_path / "a.glb")


@pytest.mark.parametrize("kind", ["fbx", "blend", "dae", "ma"])
def test_other_kinds_of_file_are_refused_with_the_way_to_make_a_glb(tmp_path, kind):
    with pytest.raises(ValueError, match=r"unknown kind; readable are .glb, .*: .*Blender.* GLB"):
        read_rig(tmp_path / f"head.{kind}")


def scene(path, change):
    """Change the JSON of a GLB of ours."""
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    told, rest = json.loads(data[20 : 20 + size]), data[20 + size :]
    change(told)
    text = json.dumps(told).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    path.write_bytes(head + text + rest)
    return path


@pytest.mark.parametrize("owner", ["meshes", "nodes"])
def test_weights_that_are_not_zero_at_rest_are_said(tmp_path, rig, owner):
    path = tmp_path / "head.glb"
    write_glb(path, rig.neutral, rig.deltas, rig.names)
    scene(path, lambda told: told[owner][0].update(weights=[0, 0.3, 0]))
    with pytest.warns(
        UserWarning, match=r"shows 'face' with browInnerUp at 0\.3; the face at rest"
    ):
        again = read_rig(path)
    np.testing.assert_allclose(again.neutral.vertices, rig.neutral.vertices, atol=1e-5)


@pytest.mark.parametrize("key", ["extras", "extra"])
def test_names_that_stand_at_the_targets_themselves_are_read(tmp_path, rig, key):
    def change(told):
        names = told["meshes"][0].pop("extras")["targetNames"]
        targets = told["meshes"][0]["primitives"][0]["targets"]
        for target, name in zip(targets, names, strict=True):
            target[key] = {"name": name}

    write_glb(tmp_path / "head.glb", rig.neutral, rig.deltas, rig.names)
    assert silently(read_rig, scene(tmp_path / "head.glb", change)).names == rig.names


def test_names_that_stand_at_the_data_of_the_targets_are_read(tmp_path, rig):
    def change(told):
        names = told["meshes"][0].pop("extras")["targetNames"]
        targets = told["meshes"][0]["primitives"][0]["targets"]
        for target, name in zip(targets, names, strict=True):
            told["accessors"][target["POSITION"]]["name"] = name

    write_glb(tmp_path / "head.glb", rig.neutral, rig.deltas, rig.names)
    assert silently(read_rig, scene(tmp_path / "head.glb", change)).names == rig.names


def in_two(told, names):
    """The face in two primitives that share all but their triangles, with names of their own."""
    (one,) = told["meshes"][0]["primitives"]
    at = told["accessors"][one["indices"]]
    half = at["count"] // 6 * 3
    rest = {**at, "byteOffset": 4 * half, "count": at["count"] - half}
    told["accessors"].append(rest)
    at["count"] = half
    for key in ("min", "max"):
        at.pop(key, None), rest.pop(key, None)
    two = {**one, "indices": len(told["accessors"]) - 1}
    one["extras"], two["extras"] = ({"targetNames": n} for n in names)
    told["meshes"][0]["primitives"].append(two)


@pytest.mark.parametrize("of_mesh", [True, False])
def test_names_in_another_order_in_each_primitive_are_refused(tmp_path, rig, of_mesh):
    def change(told):
        a, b, c = told["meshes"][0]["extras"]["targetNames"]
        in_two(told, ([a, b, c], [b, a, c]))
        if not of_mesh:
            del told["meshes"][0]["extras"]

    write_glb(tmp_path / "head.glb", rig.neutral, rig.deltas, rig.names)
    with pytest.raises(ValueError, match=r"target 0 is .* in meshes\[0\].*primitives\[1\].*order"):
        read_rig(scene(tmp_path / "head.glb", change))


def test_primitives_with_the_same_names_or_none_make_one_face(tmp_path, rig):
    write_glb(tmp_path / "head.glb", rig.neutral, rig.deltas, rig.names)
    scene(tmp_path / "head.glb", lambda told: in_two(told, (list(rig.names), ["", "", ""])))
    again = silently(read_rig, tmp_path / "head.glb")
    assert again.names == rig.names and again.neutral.n_vertices == rig.neutral.n_vertices


def test_shapes_that_change_normals_alone_are_said(tmp_path, rig):
    def change(told):
        for target in told["meshes"][0]["primitives"][0]["targets"]:
            target["NORMAL"] = target.pop("POSITION")

    write_glb(tmp_path / "head.glb", rig.neutral, rig.deltas, rig.names)
    with pytest.warns(UserWarning, match="none of the 3 shapes of 'face' moves a vertex"):
        read_rig(scene(tmp_path / "head.glb", change))


def add_mesh(path, mesh, deltas, names, name):
    """Put another mesh with shapes into a GLB of ours, under a node of that name."""
    write_glb(path.parent / "other.glb", mesh, deltas, names)
    data = (path.parent / "other.glb").read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    other = json.loads(data[20 : 20 + size])
    uri = "data:application/octet-stream;base64," + base64.b64encode(data[28 + size :]).decode()

    def join(told):
        n, m = len(told["accessors"]), len(told["bufferViews"])
        told["buffers"].append({**other["buffers"][0], "uri": uri})
        told["bufferViews"] += [{**v, "buffer": 1} for v in other["bufferViews"]]
        for at in other["accessors"]:
            for place in (at, *(at["sparse"][k] for k in ("indices", "values") if "sparse" in at)):
                if "bufferView" in place:
                    place["bufferView"] += m
            told["accessors"].append(at)
        mesh = other["meshes"][0]
        for primitive in mesh["primitives"]:
            primitive.pop("material", None)
            for owner in (primitive["attributes"], *primitive["targets"]):
                owner.update({k: v + n for k, v in owner.items()})
            primitive["indices"] += n
        told["meshes"].append(mesh)
        told["nodes"].append({"mesh": 1, "name": name})
        told["scenes"][0]["nodes"].append(len(told["nodes"]) - 1)

    return scene(path, join)


def test_the_largest_that_moves_is_the_face_and_not_a_dense_beard(tmp_path, rig):
    """A parent of two meshes with the same shapes: a head, and a finer beard on its chin."""
    beard = sphere_mesh(3, radius=20.0)
    near = np.ones((1, beard.n_vertices, 1))
    path = tmp_path / "head.glb"
    write_glb(path, rig.neutral, rig.deltas, rig.names)
    add_mesh(path, beard, near * np.ones((3, 1, 3)), rig.names, "Beard")
    found = silently(read_rig, path)
    assert (found.source.mesh, list(found.parts)) == ("face", ["Beard"])


def test_a_face_in_two_meshes_is_said(tmp_path, rig):
    path, left = (
        tmp_path / "head.glb",
        rig.neutral.vertices[rig.neutral.faces].mean(axis=1)[:, 0] > 0,
    )
    halves = []
    for side in (left, ~left):
        kept = np.unique(rig.neutral.faces[side])
        new = np.cumsum(np.isin(np.arange(162), kept)) - 1
        mesh = TriangleMesh(rig.neutral.vertices[kept], new[rig.neutral.faces[side]])
        halves.append((mesh, rig.deltas[:, kept], rig.names))
    write_glb(path, *halves[0])
    add_mesh(path, *halves[1], "face")
    words = r"'face' alone is read as the face, but 'face \(2\)' have the same shapes and touch it"
    with pytest.warns(UserWarning, match=words):
        assert list(read_rig(path).parts) == ["face (2)"]
    with pytest.warns(UserWarning, match=words):
        read_rig(path, mesh="face")


def test_a_second_face_is_said_unless_one_was_chosen(tmp_path, rig):
    path = tmp_path / "head.glb"
    write_glb(path, rig.neutral, rig.deltas, rig.names)
    other = TriangleMesh(rig.neutral.vertices + [300, 0, 0], rig.neutral.faces)
    add_mesh(path, other, rig.deltas, rig.names, "Twin")
    with pytest.warns(UserWarning, match="'Twin' have the same shapes and are as large. Choose"):
        read_rig(path)
    assert silently(read_rig, path, mesh="Twin").source.mesh == "Twin"


def test_of_several_levels_of_detail_the_finest_is_read(tmp_path, rig):
    coarse = sphere_mesh(1, radius=101.0)
    top = rig.neutral.vertices[:, 2].argmax()
    far = rig.deltas[:, [top]] * np.ones((coarse.n_vertices, 1))
    path = tmp_path / "head.glb"
    write_glb(path, coarse, far, rig.names)
    add_mesh(path, rig.neutral, rig.deltas, rig.names, "LOD0")
    with pytest.warns(UserWarning, match="'LOD0' is read as the face; 'face' have the same shapes"):
        assert read_rig(path).neutral.n_vertices == rig.neutral.n_vertices


@pytest.mark.parametrize("factor", [1000, 0.001])
def test_shapes_in_another_unit_than_the_mesh_are_said(tmp_path, rig, factor):
    write_glb(tmp_path / "head.glb", rig.neutral, factor * rig.deltas, rig.names)
    with pytest.warns(UserWarning, match=r"move it by at most .* seem to be in another unit"):
        read_rig(tmp_path / "head.glb")


def test_a_part_that_lies_in_one_point_is_passed_over_and_said(tmp_path, rig):
    def change(told):
        place = {**told["accessors"][0], "min": [0] * 3, "max": [0] * 3}
        place.pop("bufferView")  # zeros
        told["accessors"].append(place)
        primitive = dict(told["meshes"][0]["primitives"][0])
        primitive.pop("targets")
        primitive["attributes"] = {"POSITION": len(told["accessors"]) - 1}
        told["meshes"].append({"primitives": [primitive]})
        told["nodes"].append({"mesh": 1, "name": "Locator"})
        told["scenes"][0]["nodes"].append(len(told["nodes"]) - 1)

    write_glb(tmp_path / "head.glb", rig.neutral, rig.deltas, rig.names)
    with pytest.warns(UserWarning, match="'Locator' lies in one point"):
        found = read_rig(scene(tmp_path / "head.glb", change))
    assert not found.parts
    with pytest.warns(UserWarning), pytest.raises(ValueError, match=r"within .* mm; give scale="):
        read_rig(tmp_path / "head.glb", scale=1e-4)


# --- a folder of OBJ files ------------------------------------------------------------------------


@pytest.mark.parametrize("rest", ["neutral", "Head_Neutral", "my basis", "face-rest"])
def test_a_folder_of_objs_becomes_a_rig(tmp_path, rig, rest):
    again = silently(read_rig, write_folder(tmp_path / "shapes", rig, rest=rest))
    assert again.names == tuple(sorted(rig.names))
    order = [rig.names.index(n) for n in again.names]
    np.testing.assert_allclose(again.deltas, rig.deltas[order], atol=1e-5)
    np.testing.assert_array_equal(again.neutral.faces, rig.neutral.faces)
    assert again.source.mesh == rest


def test_the_face_at_rest_is_named_or_asked_for(tmp_path, rig):
    folder = write_folder(tmp_path / "shapes", rig, rest="pose_0")
    with pytest.raises(ValueError, match=r"which OBJ is the face at rest\?.* one of browInnerUp"):
        read_rig(folder)
    assert len(read_rig(folder, neutral="pose_0").names) == 3
    assert len(read_rig(folder, neutral="pose_0.obj").names) == 3
    with pytest.raises(ValueError, match="neutral='pose_1' is not in it; its OBJ files are"):
        read_rig(folder, neutral="pose_1")


def test_shapes_of_another_mesh_or_another_order_are_refused_by_name(tmp_path, rig, rng):
    folder = write_folder(tmp_path / "shapes", rig)
    write_obj(folder / "zz.obj", sphere_mesh(1, radius=100))
    with pytest.raises(ValueError, match=r"zz.obj: 42 vertices, but neutral.obj has 162"):
        read_rig(folder)
    mixed = rng.permutation(162)
    place = np.argsort(mixed)
    write_obj(
        folder / "zz.obj", TriangleMesh(rig.neutral.vertices[mixed], place[rig.neutral.faces])
    )
    with pytest.raises(ValueError, match=r"zz.obj: its faces are not those of neutral.obj, so its"):
        read_rig(folder)


def swapped(faces, a, b):
    """Faces of a mesh whose vertices a and b stand in the other order."""
    new = np.arange(faces.max() + 1)
    new[[a, b]] = b, a
    return new[faces]


def test_two_vertices_that_changed_places_are_refused(tmp_path, rig):
    folder = write_folder(tmp_path / "shapes", rig)
    a, b = rig.neutral.faces[7, :2]
    V = rig.neutral.vertices + rig.deltas[1]
    V[[a, b]] = V[[b, a]]
    write_obj(folder / "browInnerUp.obj", TriangleMesh(V, swapped(rig.neutral.faces, a, b)))
    with pytest.raises(ValueError, match=r"browInnerUp\.obj: its faces are not those of neutral"):
        read_rig(folder)


def test_the_same_faces_in_another_order_are_the_same(tmp_path, rig, rng):
    folder = write_folder(tmp_path / "shapes", rig)
    faces = np.roll(rng.permutation(rig.neutral.faces), 1, axis=1)
    V = rig.neutral.vertices + rig.deltas[1]
    write_obj(folder / "browInnerUp.obj", TriangleMesh(V, faces))
    found = silently(read_rig, folder)
    moved = found.deltas[found.names.index("browInnerUp")]
    np.testing.assert_allclose(moved, rig.deltas[1], atol=1e-4)


@pytest.mark.parametrize("shuffled", [False, True])
def test_quads_that_are_cut_otherwise_are_the_same_faces(tmp_path, rig, rng, shuffled):
    """Triangles 4 and 5 of a shape are the same quad, cut along its other diagonal."""
    faces = rig.neutral.faces.copy()
    a, b, c = faces[4]
    pair = next(k for k, f in enumerate(faces) if k > 5 and {b, c} <= {*f.tolist()})
    faces[[5, pair]] = faces[[pair, 5]]
    (d,) = {*faces[5].tolist()} - {b, c}
    rest = TriangleMesh(rig.neutral.vertices, faces)
    folder = write_folder(tmp_path / "shapes", BlendshapeRig(rest, rig.names, rig.deltas))
    other = faces.copy()
    other[[4, 5]] = [[a, b, d], [a, d, c]]
    if shuffled:
        other = rng.permutation(other)
    shape = TriangleMesh(rest.vertices + rig.deltas[1], other)
    write_obj(folder / "browInnerUp.obj", shape)
    found = silently(read_rig, folder)
    np.testing.assert_allclose(
        found.deltas[found.names.index("browInnerUp")], rig.deltas[1], atol=1e-4
    )


@pytest.mark.parametrize(
    "change",
    [
        lambda V: V / 10,
        lambda V: V + [300, 0, 0],
        lambda V: V[:, [0, 2, 1]] * [1, -1, 1],
        lambda V: V * [-1, 1, 1],
        lambda V: V[::-1],
    ],
    ids=["centimetres", "beside it", "z up", "mirrored", "order"],
)
def test_a_shape_in_another_unit_place_or_order_is_refused(tmp_path, rig, change):
    folder = write_folder(tmp_path / "shapes", rig)
    V = change(rig.neutral.vertices + rig.deltas[0])
    write_obj(folder / "jawOpen.obj", TriangleMesh(V, rig.neutral.faces))
    with pytest.raises(ValueError, match=r"jawOpen\.obj: its vertices lie .* times as far from"):
        read_rig(folder)


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda V: V + [0, 30, 0], r"\(by 30\.0 mm\)"),
        (lambda V: V + [0, 2, 0], r"\(by 2\.0 mm\)"),
        (lambda V: V * 1.02, r"\(2\.0% larger\)"),
        (lambda V: V * 0.98, r"\(2\.0% smaller\)"),
        (lambda V: V @ Rotation.from_euler("x", 2, degrees=True).as_matrix(), "by 2.0 degrees"),
    ],
)
@pytest.mark.parametrize("kind", ["folder", "glb"])
def test_a_shape_that_moves_the_whole_head_is_said(tmp_path, rig, kind, change, words):
    deltas = rig.deltas.copy()
    deltas[0] = change(rig.neutral.vertices + deltas[0]) - rig.neutral.vertices
    if kind == "folder":
        path = write_folder(tmp_path / "shapes", BlendshapeRig(rig.neutral, rig.names, deltas))
    else:
        path = tmp_path / "head.glb"
        write_glb(path, rig.neutral, deltas, rig.names)
    with pytest.warns(UserWarning, match=rf": 1 shape.* the whole head.*: jawOpen.*{words}"):
        read_rig(path)


def test_files_that_hold_the_face_at_rest_again_are_no_shapes(tmp_path, rig):
    folder = write_folder(tmp_path / "shapes", rig)
    for name in ("Basis", "zz"):
        write_obj(folder / f"{name}.obj", rig.neutral)
    with pytest.warns(UserWarning, match=r"Basis\.obj, zz\.obj \(2\) hold the face at rest as neu"):
        found = read_rig(folder)
    assert sorted(found.names) == sorted(rig.names) and len(found.deltas) == 3
    np.testing.assert_allclose(found.deltas[found.names.index("jawOpen")], rig.deltas[0], atol=1e-4)
    for name in rig.names:
        (folder / f"{name}.obj").unlink()
    with pytest.raises(ValueError, match="all of its OBJ files hold the same face"):
        read_rig(folder)


def test_hidden_files_and_folders_are_no_shapes(tmp_path, rig):
    folder = write_folder(tmp_path / "shapes", rig)
    (folder / "._neutral.obj").write_bytes(b"\0\5\x16\7")
    (folder / "more.obj").mkdir()
    assert sorted(silently(read_rig, folder).names) == sorted(rig.names)
    (folder / "jawOpen.OBJ").write_bytes((folder / "neutral.obj").read_bytes())
    if len(list(folder.iterdir())) == 7:  # a file system that tells capitals apart
        with pytest.raises(ValueError, match="differs only in the capitals of its ending"):
            read_rig(folder)


@pytest.mark.parametrize("name", ["headNeutral", "1_neutral", "Head-Basis"])
def test_a_word_within_a_name_tells_the_face_at_rest(tmp_path, rig, name):
    found = read_rig(write_folder(tmp_path / "shapes", rig, rest=name))
    assert found.source.path.endswith(f"{name}.obj")


def test_what_is_not_there_or_one_of_many_objs_is_refused_with_what_to_give(tmp_path, rig):
    with pytest.raises(FileNotFoundError, match="there is no such file or folder"):
        read_rig(tmp_path / "shapes")
    folder = write_folder(tmp_path / "shapes", rig)
    with pytest.raises(ValueError, match="give the folder"):
        read_rig(folder / "neutral.obj")


def test_a_folder_without_shapes_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"0 OBJ file\(s\) in it; a rig needs one for the face at"):
        read_rig(tmp_path)


def test_an_object_of_the_objs_can_be_chosen(tmp_path, rig):
    folder = write_folder(tmp_path / "shapes", rig)
    for file in folder.iterdir():
        file.write_text(file.read_text() + "o Eye\nv 0 0 0\nv 9 0 0\nv 0 9 0\nf -1 -2 -3\n")
        text = file.read_text()
        file.write_text(text.replace("f ", "o Head\nf ", 1))
    assert silently(read_rig, folder, mesh="Head").neutral.n_vertices == 162
    assert read_rig(folder).neutral.n_vertices == 165


# --- size -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit, scale", [(1000, 0.001), (10, 0.1), (100, 0.01), (25.4, 1 / 25.4)])
def test_the_unit_of_objs_is_taken_from_the_size_of_a_face_and_said(tmp_path, rig, unit, scale):
    folder = write_folder(tmp_path / "shapes", rig, scale)
    with pytest.warns(UserWarning, match=f"it is read with scale={unit}, .*Give scale="):
        again = read_rig(folder)
    np.testing.assert_allclose(again.neutral.vertices, rig.neutral.vertices, atol=1e-3)
    assert again.source.scale == unit
    np.testing.assert_allclose(silently(read_rig, folder, scale=unit).deltas, again.deltas)


@pytest.mark.parametrize("scale, unit", [(100, 10), (1000, 1), (1000 / 25.4, 25.4)])
def test_a_glb_that_does_not_count_in_metres_is_noticed(tmp_path, rig, scale, unit):
    mesh = rig.neutral.with_vertices(rig.neutral.vertices * scale)
    write_glb(tmp_path / "a.glb", mesh, rig.deltas * scale, rig.names)
    with pytest.warns(UserWarning, match=f"it is read with scale={unit}, .*Give scale="):
        again = read_rig(tmp_path / "a.glb")
    np.testing.assert_allclose(again.neutral.vertices, rig.neutral.vertices, atol=1e-3)


def test_a_scale_that_makes_no_face_is_said_but_kept(tmp_path, rig):
    folder = write_folder(tmp_path / "shapes", rig)
    with pytest.warns(UserWarning, match="longest side is 2000 mm.*or a whole body: give scale=1"):
        again = read_rig(folder, scale=10)
    assert np.ptp(again.neutral.vertices, axis=0).max() == pytest.approx(2000, rel=1e-3)


def test_the_face_of_a_whole_body_is_what_its_shapes_move(tmp_path, rig):
    body = sphere_mesh(2, radius=900.0)
    n = rig.neutral.n_vertices
    V = np.vstack([rig.neutral.vertices, body.vertices - [0, 1010, 0]])
    mesh = TriangleMesh(V, np.vstack([rig.neutral.faces, body.faces + n]))
    deltas = np.concatenate([rig.deltas, np.zeros((3, body.n_vertices, 3))], axis=1)
    write_glb(tmp_path / "body.glb", mesh, deltas, rig.names)
    again = silently(read_rig, tmp_path / "body.glb")
    np.testing.assert_allclose(again.neutral.vertices, V, atol=1e-3)
    assert again.still.sum() == body.n_vertices  # still parts are told from skin


# --- our own --------------------------------------------------------------------------------------


def test_a_rig_in_an_npz_comes_back_as_it_was(tmp_path, rig, rng):
    people = {"a": rng.normal(size=(162, 3)), "b": rng.normal(size=(162, 3))}
    rig = BlendshapeRig(rig.neutral, rig.names, rig.deltas.astype(np.float32), people)
    write_rig(tmp_path / "rig.npz", rig)
    again = silently(read_rig, tmp_path / "rig.npz")
    assert again.names == rig.names and again.neutral.landmarks == {"chin": 4}
    np.testing.assert_array_equal(again.neutral.vertices, rig.neutral.vertices)
    np.testing.assert_array_equal(again.deltas, rig.deltas)
    assert list(again.identities) == ["a", "b"]
    np.testing.assert_array_equal(again.identities["b"], people["b"])
    with pytest.raises(ValueError, match="holds one mesh in millimetres; leave out mesh and scale"):
        read_rig(tmp_path / "rig.npz", scale=10)


@pytest.mark.parametrize(
    "name, value, words",
    [
        ("deltas", np.zeros((3, 5, 3)), r"rig.npz: deltas has shape \(3, 5, 3\)"),
        ("deltas", np.full((3, 162, 3), np.nan), "rig.npz: deltas holds .* NaN"),
        ("names", np.array(["a", "a", "b"]), "rig.npz: names holds a more than once"),
        ("names", np.arange(3), "its array 'names' is missing or of another type"),
        ("landmarks", np.array([999]), r"rig.npz: landmarks\['chin'\]=999"),
        (
            "landmark_names",
            np.array(["a", "b"]),
            "landmark_names and landmarks are not of the same",
        ),
    ],
)
def test_an_npz_that_does_not_agree_is_refused(tmp_path, rig, monkeypatch, name, value, words):
    from facelab.files import rigs

    save = rigs.save_npz
    monkeypatch.setattr(rigs, "save_npz", lambda *a, **k: save(*a, **{**k, name: value}))
    write_rig(tmp_path / "rig.npz", rig)
    with pytest.raises(ValueError, match=words):
        read_rig(tmp_path / "rig.npz")


# --- names ----------------------------------------------------------------------------------------


def test_a_rig_and_its_parts_are_renamed():
    rig = read_rig(FIXTURES / "avatar.glb")
    again = rig.renamed({"jawOpen": "AU26", "browInnerUp": "AU1"})
    assert again.names == ("AU26", "eyeBlinkLeft", "mouthSmileRight", "AU1")
    assert again.parts["Teeth"].names == ("AU26",)
    assert again.source is rig.source and again.deltas is rig.deltas
    with pytest.raises(ValueError, match=r"unknown shape.* jawShut; this rig has"):
        rig.renamed({"jawShut": "AU26"})
    with pytest.raises(ValueError, match="names holds browInnerUp more than once"):
        rig.renamed({"jawOpen": "browInnerUp"})


@pytest.mark.real
def test_the_generic_face_is_read_from_its_folder(ict_root, tmp_path, real_rig):
    for name in ("generic_neutral_mesh", "jawOpen", "mouthSmile_L"):
        (tmp_path / f"{name}.obj").symlink_to(ict_root / "FaceXModel" / f"{name}.obj")
    with pytest.warns(UserWarning, match="it is read with scale=10"):
        rig = read_rig(tmp_path)
    assert (rig.names, len(rig.source.index)) == (("jawOpen", "mouthSmile_L"), 26719)
    at = rig.source.index[:6706]
    np.testing.assert_allclose(rig.neutral.vertices[at], real_rig.neutral.vertices, atol=1e-3)
    jaw = real_rig.deltas[real_rig.names.index("jawOpen")]
    np.testing.assert_allclose(rig.deltas[0, at], jaw, atol=0.02)


@pytest.mark.parametrize("name", ["avatar", "avatar_quantised", "avatar_sparse"])
def test_mutants_of_a_rig_are_refused_in_our_words_or_make_a_rig(tmp_path, rng, name):
    def contradicts(rig, data, said):
        found = np.isfinite(rig.deltas).all() and np.isfinite(rig.neutral.vertices).all()
        fits = len(rig.names) == len(rig.deltas) and rig.source.index.max() < rig.deltas.shape[1]
        return "" if found and fits else "no rig"

    data = (FIXTURES / f"{name}.glb").read_bytes()
    found = tally(read_rig, data, "a.glb", tmp_path, COUNT // 3, rng, contradicts)
    assert not found.wrong and not found.python, found
