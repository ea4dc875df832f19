import hashlib
import json
import os

import numpy as np
import pytest

from facelab.data import __main__ as command
from facelab.data import cache
from facelab.data import ict as ict_module
from facelab.data.actors import load_template
from facelab.data.cache import DataUnavailable
from facelab.data.examples import load_example
from facelab.data.ict import load_ict_facekit, load_ict_props
from facelab.data.markers import MARKERS, load_markers
from facelab.data.takes import TAKES, load_take
from facelab.geometry.mesh import MULTI_PIE
from facelab.keeping import fault

# the clone that is made here has no texture coordinates for its faces
pytestmark = pytest.mark.filterwarnings("ignore:.*they are passed over here")


@pytest.fixture
def empty_machine(tmp_path, monkeypatch):
    """A machine with an empty cache, no folder named, and no network: gives the cache folder."""

    def retrieve(*_, **__):
        raise ConnectionError("no route to host")

    monkeypatch.setattr(cache.pooch, "retrieve", retrieve)
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path / "cache"))
    for variable in ("ICT", "CAPTURES", "ANIMFACE", "AURA", "OFFLINE"):
        monkeypatch.delenv(f"FACELAB_{variable}", raising=False)
    return tmp_path / "cache"


@pytest.fixture
def ict(ict_root, ict_cache, monkeypatch):
    """ICT-FaceKit by its folder, parsed before; parsing it once more would be an error."""
    monkeypatch.setenv("FACELAB_CACHE", str(ict_cache))
    monkeypatch.setenv("FACELAB_ICT", str(ict_root))
    monkeypatch.setattr(ict_module, "read_obj", lambda path: pytest.fail(f"{path} parsed again"))
    return ict_root


def surface_loops(mesh):
    return len(mesh.boundary_loops), len(np.unique(mesh.pieces))


# --- the scanned face -----------------------------------------------------------------------------


@pytest.mark.real
@pytest.mark.parametrize("area, n_vertices", [("narrow", 6706), ("face", 9409), ("all", 26719)])
def test_the_face_comes_in_three_sizes_that_share_their_vertices(ict, area, n_vertices, real_rig):
    rig = load_ict_facekit(area=area)
    assert rig.neutral.n_vertices == n_vertices
    assert rig.deltas.shape == (53, n_vertices, 3)
    np.testing.assert_array_equal(rig.neutral.vertices[:6706], real_rig.neutral.vertices)
    np.testing.assert_array_equal(rig.deltas[:, :6706], real_rig.deltas)
    used = np.unique(rig.neutral.faces)
    np.testing.assert_array_equal(used, np.arange(n_vertices))  # no vertex hangs loose


@pytest.mark.real
def test_the_narrow_face_is_one_piece_with_eyes_mouth_and_outline_open(real_rig):
    assert surface_loops(real_rig.neutral) == (4, 1)


@pytest.mark.real
def test_the_face_is_as_large_as_a_face_in_millimetres(real_rig):
    place = {name: real_rig.neutral.vertices[v] for name, v in real_rig.neutral.landmarks.items()}

    def between(a, b):
        return np.linalg.norm(place[a] - place[b])

    # ranges that hold adults: in centimetres or metres each would be ten or more times off
    assert 75 < between("eye_right_outer", "eye_left_outer") < 115
    assert 40 < between("mouth_corner_right", "mouth_corner_left") < 65
    assert 95 < between("nose_bridge_1", "chin") < 140


@pytest.mark.real
@pytest.mark.parametrize("name", [n for n in MULTI_PIE if "right" in n])
def test_landmarks_are_on_the_side_that_their_names_say(real_rig, name):
    mesh = real_rig.neutral
    right = mesh.vertices[mesh.landmarks[name]]
    left = mesh.vertices[mesh.landmarks[name.replace("right", "left")]]
    assert right[0] < 0 < left[0]
    np.testing.assert_allclose(right * [-1, 1, 1], left, atol=5)  # an average face is nearly even


@pytest.mark.real
def test_landmarks_stand_above_and_before_one_another_as_in_a_face(real_rig):
    mesh = real_rig.neutral
    x, y, z = (
        {name: mesh.vertices[v][axis] for name, v in mesh.landmarks.items()} for axis in range(3)
    )
    order = ("brow_left_3", "eye_left_upper_inner", "eye_left_lower_inner", "nose_tip")
    order += ("lip_upper", "mouth_inner_upper", "lip_lower", "chin")
    heights = [y[name] for name in order]
    assert heights == sorted(heights, reverse=True)
    assert z["nose_tip"] == max(z.values())
    assert abs(x["nose_tip"]) < 2 and abs(x["chin"]) < 2
    assert x["eye_left_inner"] < x["eye_left_outer"]
    assert x["brow_left_5"] < x["brow_left_1"]
    assert x["jaw_left_8"] < x["jaw_left_1"]


@pytest.mark.real
def test_faces_of_the_face_look_forward(real_rig):
    mesh = real_rig.neutral
    for name in ("nose_tip", "chin", "brow_left_3", "lip_lower"):
        assert mesh.normals[mesh.landmarks[name], 2] > 0.3


def size_of(rig, name):
    return np.linalg.norm(rig.deltas[rig.names.index(name)], axis=1)


@pytest.mark.real
@pytest.mark.parametrize("side, sign", [("L", 1), ("R", -1)])
def test_a_blink_moves_the_lids_of_its_own_side_alone(real_rig, side, sign):
    mesh, size = real_rig.neutral, size_of(real_rig, f"eyeBlink_{side}")
    eye = "eye_left_" if side == "L" else "eye_right_"
    centre = np.mean([mesh.vertices[v] for n, v in mesh.landmarks.items() if n.startswith(eye)], 0)
    assert size[mesh.vertices[:, 0] * sign < 0].max() < 0.1  # mm
    assert 5 < size.max() < 20
    moved = mesh.vertices[size > 0.1 * size.max()]
    assert np.linalg.norm(moved - centre, axis=1).max() < 35  # millimetres: the eye's surroundings
    k = real_rig.names.index(f"eyeBlink_{side}")
    upper, lower = (mesh.landmarks[f"{eye}{lid}_inner"] for lid in ("upper", "lower"))
    assert real_rig.deltas[k, upper, 1] < -4  # the upper lid comes down
    assert abs(real_rig.deltas[k, lower, 1]) < 3


@pytest.mark.real
@pytest.mark.parametrize(
    "name, landmark, axis, sign",
    [
        ("jawOpen", "chin", 1, -1),
        ("mouthSmile_L", "mouth_corner_left", 1, 1),
        ("mouthSmile_R", "mouth_corner_right", 1, 1),
        ("browInnerUp_L", "brow_left_5", 1, 1),
        ("browInnerUp_R", "brow_right_5", 1, 1),
        ("jawLeft", "chin", 0, 1),
        ("jawRight", "chin", 0, -1),
    ],
)
def test_expressions_move_what_their_names_say(real_rig, name, landmark, axis, sign):
    mesh = real_rig.neutral
    move = real_rig.deltas[real_rig.names.index(name), mesh.landmarks[landmark]]
    assert sign * move[axis] > 2


@pytest.mark.parametrize("n_identities", [-1, 101])
def test_more_identities_than_there_are_or_less_than_none_are_refused(n_identities):
    with pytest.raises(ValueError, match=f"n_identities={n_identities}, but ICT-FaceKit has 100"):
        load_ict_facekit(n_identities=n_identities)


@pytest.mark.real
def test_the_files_are_those_whose_checksums_we_carry(ict_root):
    checksums = ict_module._ict_checksums()
    folder = ict_root / "FaceXModel"
    index = json.loads((folder / "vertex_indices.json").read_text())
    wanted = {"generic_neutral_mesh.obj", "vertex_indices.json"}
    wanted |= {f"{name}.obj" for name in index["expressions"]}
    wanted |= {f"identity{i:03d}.obj" for i in range(100)}
    assert wanted <= set(checksums)
    for name in ("generic_neutral_mesh.obj", "vertex_indices.json", "jawOpen.obj"):
        assert cache.pooch.file_hash(folder / name, alg="sha256") == checksums[name]


@pytest.mark.real
@pytest.mark.parametrize("name", TAKES)
def test_the_takes_are_those_whose_checksums_we_carry(captures_root, name):
    found = cache.pooch.file_hash(captures_root / f"{name}.csv", alg="sha256")
    assert found == TAKES[name]


# --- the cache, on a small ICT-FaceKit made here --------------------------------------------------

SMALL = {"narrow": (6, 2), "face": (8, 3), "all": (9, 4)}


@pytest.fixture
def small_ict(tmp_path, monkeypatch):
    """A clone of ICT-FaceKit with nine vertices: a strip of quads and a triangle."""
    monkeypatch.setattr(ict_module, "ICT_AREAS", SMALL)
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "clone" / "FaceXModel"
    folder.mkdir(parents=True)
    V = np.array([[i // 2, i % 2, 0] for i in range(9)], dtype=float)

    def obj(V):
        faces = "f 1/1 3/1 4/1 2/1\nf 3/1 5/1 6/1 4/1\nf 5/1 7/1 8/1 6/1\nf 7/1 9/1 8/1\n"
        return "".join(f"v {x} {y} {z}\n" for x, y, z in V) + faces

    (folder / "generic_neutral_mesh.obj").write_text(obj(V))
    for k, name in enumerate(["jawOpen", "eyeBlink_L", "identity000", "identity001"]):
        (folder / f"{name}.obj").write_text(obj(V + np.array([0, 0, (k + 1) / 8])))
    index = {"expressions": ["jawOpen", "eyeBlink_L"], "idx_to_landmark_verts": [0, 1] * 34}
    (folder / "vertex_indices.json").write_text(json.dumps(index))
    return tmp_path / "clone"


def test_files_in_centimetres_become_a_rig_in_millimetres(small_ict):
    rig = load_ict_facekit(small_ict, n_identities=2)
    np.testing.assert_allclose(rig.neutral.vertices[5], [20, 10, 0])
    assert rig.names == ("jawOpen", "eyeBlink_L")
    np.testing.assert_allclose(rig.deltas[:, 0, 2], [1.25, 2.5])
    assert [s[0, 2] for s in rig.identities.values()] == [3.75, 5.0]


@pytest.mark.parametrize("area, n_triangles", [("narrow", 4), ("face", 6), ("all", 7)])
def test_an_area_has_the_triangles_of_its_polygons(small_ict, area, n_triangles):
    mesh = load_ict_facekit(small_ict, area=area).neutral
    assert (mesh.n_vertices, len(mesh.faces)) == (SMALL[area][0], n_triangles)


@pytest.mark.parametrize("folder", ["", "FaceXModel"])
def test_the_clone_or_the_folder_within_may_be_named(small_ict, folder):
    assert load_ict_facekit(small_ict / folder).neutral.n_vertices == 6


def test_the_environment_variable_names_the_clone(small_ict, monkeypatch):
    monkeypatch.setenv("FACELAB_ICT", str(small_ict))
    assert load_ict_facekit().neutral.n_vertices == 6


def cached(tmp_path):
    (path,) = (tmp_path / "cache").glob("ict_*/arrays.npz")
    return path


def test_a_second_load_parses_nothing(small_ict, monkeypatch):
    first = load_ict_facekit(small_ict)
    monkeypatch.setattr(ict_module, "read_obj", lambda path: pytest.fail("parsed again"))
    again = load_ict_facekit(small_ict)
    np.testing.assert_array_equal(again.deltas, first.deltas)
    np.testing.assert_array_equal(again.neutral.vertices, first.neutral.vertices)
    np.testing.assert_array_equal(again.neutral.faces, first.neutral.faces)
    assert again.neutral.landmarks == first.neutral.landmarks


@pytest.mark.parametrize("part", [0, 0.3, 0.95])
def test_a_damaged_cache_file_is_made_again(small_ict, tmp_path, part):
    first = load_ict_facekit(small_ict)
    path = cached(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * part)])
    again = load_ict_facekit(small_ict)
    np.testing.assert_array_equal(again.deltas, first.deltas)
    assert fault(cached(tmp_path).parent) is None


def test_a_changed_file_is_not_answered_from_the_cache(small_ict):
    assert load_ict_facekit(small_ict).shape({"jawOpen": 1})[0, 2] == 1.25
    path = small_ict / "FaceXModel" / "jawOpen.obj"
    path.write_text(path.read_text().replace("0.125", "0.500"))
    later = path.stat().st_mtime_ns + 10**9
    os.utime(path, ns=(later, later))
    assert load_ict_facekit(small_ict).shape({"jawOpen": 1})[0, 2] == 5


# --- what is not there ----------------------------------------------------------------------------


def test_a_folder_without_the_files_is_refused_by_its_name(tmp_path, empty_machine, monkeypatch):
    with pytest.raises(
        FileNotFoundError, match=r"root=.* holds no FaceXModel/generic_neutral_mesh"
    ):
        load_ict_facekit(tmp_path)
    monkeypatch.setenv("FACELAB_ICT", str(tmp_path / "gone"))
    with pytest.raises(FileNotFoundError, match=r"FACELAB_ICT=.*gone.*give the folder of a clone"):
        load_ict_facekit()


def test_a_missing_expression_is_refused_by_its_name(small_ict):
    (small_ict / "FaceXModel" / "eyeBlink_L.obj").unlink()
    with pytest.raises(FileNotFoundError, match=r"eyeBlink_L.obj"):
        load_ict_facekit(small_ict)


def test_a_neutral_of_another_size_is_refused(small_ict, monkeypatch):
    monkeypatch.setattr(ict_module, "ICT_AREAS", {**SMALL, "all": (10, 4)})
    with pytest.raises(
        ValueError, match=r"neutral_mesh.obj has 9 vertices, but ICT-FaceKit has 10"
    ):
        load_ict_facekit(small_ict)


def test_an_expression_of_another_size_is_refused(small_ict):
    path = small_ict / "FaceXModel" / "jawOpen.obj"
    path.write_text("v 0 0 0\n" + path.read_text())
    with pytest.raises(ValueError, match=r"jawOpen.obj has 10 vertices, the neutral 9"):
        load_ict_facekit(small_ict)


def test_a_damaged_list_of_landmarks_is_refused_by_its_name(small_ict):
    (small_ict / "FaceXModel" / "vertex_indices.json").write_text('{"expressions": [')
    with pytest.raises(ValueError, match=r"vertex_indices.json"):
        load_ict_facekit(small_ict)


def test_an_unknown_area_is_refused_with_those_known(empty_machine):
    with pytest.raises(ValueError, match=r"area='ears' is unknown; .*'narrow', 'face', 'all'"):
        load_ict_facekit(area="ears")


def test_an_unknown_take_is_refused_with_those_known(empty_machine):
    with pytest.raises(ValueError, match=r"name='bob' is unknown; .*'alex_rom_3', 'alex_rom_4'"):
        load_take("bob")


def test_a_take_missing_from_its_folder_is_refused_by_name(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"alex_rom_3.csv"):
        load_take("alex_rom_3", tmp_path)


LOADERS = {
    "load_ict_facekit": load_ict_facekit,
    "load_ict_props": load_ict_props,
    **{f"load_take {name}": lambda name=name: load_take(name) for name in TAKES},
    **{f"load_markers {name}": lambda name=name: load_markers(name) for name in MARKERS},
}


@pytest.mark.parametrize("name", LOADERS)
def test_without_files_and_network_the_remedy_is_said(empty_machine, name):
    with pytest.raises(DataUnavailable) as refusal:
        LOADERS[name]()
    words = str(refusal.value)
    for needed in ("ConnectionError", "copy the data", "FACELAB_ICT", "FACELAB_CAPTURES"):
        assert needed in words
    assert not list(empty_machine.glob("*.npz"))  # nothing half-made is kept


@pytest.fixture
def offline(empty_machine, monkeypatch):
    """An empty machine where downloads are forbidden: an attempt at one fails the test."""
    monkeypatch.setenv("FACELAB_OFFLINE", "1")
    monkeypatch.setattr(cache.pooch, "retrieve", lambda url, **_: pytest.fail(f"asked {url}"))
    return empty_machine


@pytest.mark.parametrize("name", LOADERS)
def test_where_downloads_are_forbidden_every_loader_says_so_with_the_remedy(offline, name):
    with pytest.raises(DataUnavailable) as refusal:
        LOADERS[name]()
    words = str(refusal.value)
    for needed in ("FACELAB_OFFLINE=1", "unset it", "copy the data", "FACELAB_ICT"):
        assert needed in words
    assert not list(offline.rglob("*.*"))


def test_where_downloads_are_forbidden_the_synthetic_data_is_made_and_the_example_is_of_it(offline):
    example = load_example()
    assert example.about.startswith("SYNTHETIC") and "FACELAB_OFFLINE=1" in example.about
    assert load_template(4375).n_vertices == 4375


def test_offline_a_file_of_the_cache_is_read_if_its_sum_is_right(offline, monkeypatch):
    text = "Timecode,BlendShapeCount,JawOpen\n00:00:00:01,1,0.5\n"
    kept = offline / "captures" / "alex_rom_4.csv"
    kept.parent.mkdir(parents=True)
    kept.write_text(text)
    with pytest.raises(DataUnavailable, match=r"alex_rom_4.csv is damaged in the cache .*captures"):
        load_take("alex_rom_4")
    monkeypatch.setitem(TAKES, "alex_rom_4", hashlib.sha256(text.encode()).hexdigest())
    assert load_take("alex_rom_4").n_frames == 1


@pytest.mark.parametrize("value", ["", "0"])
def test_an_empty_or_zero_switch_forbids_nothing(offline, monkeypatch, value):
    monkeypatch.setenv("FACELAB_OFFLINE", value)
    with pytest.raises(pytest.fail.Exception, match=r"asked https://.*alex_rom_3.csv"):
        load_take("alex_rom_3")


@pytest.mark.parametrize("machine", ["empty_machine", "offline"])
def test_preparing_without_network_says_so_and_goes_on(machine, request, capsys):
    request.getfixturevalue(machine)
    command.main()
    said = capsys.readouterr()
    assert "Real data is not at hand" in said.err
    assert "synthetic" in said.err
    assert not said.out


def test_a_download_is_checked_against_its_sum(empty_machine, monkeypatch, tmp_path):
    asked = []

    def retrieve(url, known_hash, fname, path, **_):
        asked.append((url, known_hash))
        (tmp_path / fname).write_text("Timecode,BlendShapeCount,JawOpen\n00:00:00:01,1,0.5\n")
        return str(tmp_path / fname)

    monkeypatch.setattr(cache.pooch, "retrieve", retrieve)
    assert load_take("alex_rom_4").n_frames == 1
    ((url, known_hash),) = asked
    assert url.startswith("https://") and url.endswith("/alex_rom_4.csv")
    assert known_hash == f"sha256:{TAKES['alex_rom_4']}"
