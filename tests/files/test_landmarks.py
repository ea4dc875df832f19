import io
import json
import re
import warnings

import numpy as np
import pytest
from mutants import tally

import facelab
from facelab.files.landmarks import read_landmarks, write_landmarks
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh


@pytest.fixture(scope="module")
def face():
    return facelab.load_template(4375)


def points_of(face):
    return face.vertices[[face.landmarks[n] for n in MULTI_PIE]]


def ljson(face, version):
    points = points_of(face).round(4).tolist()
    labels = [
        {"label": "jaw", "mask": list(range(17))},
        {"label": "rest", "mask": list(range(17, 68))},
    ]
    held = {"landmarks": {"points": points, "connectivity": [[0, 1]]}, "labels": labels}
    if version == 1:
        groups = [
            {"label": n, "landmarks": [{"point": p}]}
            for n, p in zip(MULTI_PIE, points, strict=True)
        ]
        return {"version": 1, "groups": groups}
    return {"version": 2, **held} if version == 2 else {"version": 3, "groups": {"LJSON": held}}


def picked(face, names=MULTI_PIE):
    lines = [
        f' <point active="1" name="{n}" x="{x:.4f}" y="{y:.4f}" z="{z:.4f}"/>'
        for n, (x, y, z) in zip(names, points_of(face), strict=True)
    ]
    head = ' <DocumentData>\n  <DataFileName name="face.obj"/>\n </DocumentData>\n'
    return (
        "<!DOCTYPE PickedPoints>\n<PickedPoints>\n"
        + head
        + "\n".join(lines)
        + "\n</PickedPoints>\n"
    )


def npy(array):
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def npz(**arrays):
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def barycentric(face):
    faces = np.array(
        [np.flatnonzero((face.faces == face.landmarks[n]).any(axis=1))[0] for n in MULTI_PIE]
    )
    at = face.faces[faces] == np.array([face.landmarks[n] for n in MULTI_PIE])[:, None]
    return dict(lmk_faces_idx=faces, lmk_b_coords=np.where(at, 0.8, 0.1))


def files_of(face):
    index = [face.landmarks[n] for n in MULTI_PIE]
    return {
        "v1.ljson": json.dumps(ljson(face, 1)).encode(),
        "v2.ljson": json.dumps(ljson(face, 2)).encode(),
        "v3.ljson": json.dumps(ljson(face, 3)).encode(),
        "named.pp": picked(face).encode(),
        "numbered.pp": picked(face, range(68)).encode(),
        "names.txt": "".join(f"{n}: {v}\n" for n, v in face.landmarks.items()).encode(),
        "row.txt": (" ".join(map(str, index)) + "\n").encode(),
        "column.csv": ("# vertices\n" + ",\n".join(map(str, index)) + "\n").encode(),
        "index.npy": npy(np.array(index)),
        "embedding.npz": npz(**barycentric(face)),
    }


@pytest.mark.parametrize("name", files_of(facelab.load_template(4375)))
def test_the_68_landmarks_come_back_from_every_kind(face, tmp_path, name):
    (tmp_path / name).write_bytes(files_of(face)[name])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_landmarks(tmp_path / name, face) == face.landmarks


@pytest.mark.parametrize("name", files_of(facelab.load_template(4375)))
def test_mutants_are_refused_in_words_or_mean_what_they_say(face, tmp_path, name, rng):
    def contradicts(found, data, said):
        bad = {n: v for n, v in found.items() if not 0 <= v < face.n_vertices}
        return f"{bad}" if bad or not found else ""

    def read(path):
        return read_landmarks(path, face)

    found = tally(read, files_of(face)[name], name, tmp_path, 200, rng, contradicts)
    assert not found.wrong and not found.python, found


def write(tmp_path, name, data):
    (tmp_path / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    return tmp_path / name


def test_missing_points_are_left_out_with_a_word(face, tmp_path):
    held = ljson(face, 2)
    held["landmarks"]["points"][30] = [None, None, None]
    path = write(tmp_path, "a.ljson", json.dumps(held))
    with pytest.warns(UserWarning, match=r"1 landmark.* missing: nose_tip"):
        found = read_landmarks(path, face)
    assert found == {n: v for n, v in face.landmarks.items() if n != "nose_tip"}


def test_points_in_metres_need_their_scale(face, tmp_path):
    held = ljson(face, 2)
    held["landmarks"]["points"] = (points_of(face) / 1000).tolist()
    path = write(tmp_path, "a.ljson", json.dumps(held))
    with pytest.raises(ValueError, match=r"of 68 landmarks lie more than 5 mm .*scale=1000"):
        read_landmarks(path, face)
    assert read_landmarks(path, face, scale=1000) == face.landmarks


def test_sides_exchanged_and_another_order_are_refused(face, tmp_path):
    swapped = {
        n.replace("left", "RIGHT").replace("right", "left").replace("RIGHT", "right"): v
        for n, v in face.landmarks.items()
    }
    path = write(tmp_path, "a.txt", "".join(f"{n} {v}\n" for n, v in swapped.items()))
    with pytest.raises(ValueError, match="left and right are exchanged"):
        read_landmarks(path, face)
    path = write(tmp_path, "b.txt", "\n".join(str(face.landmarks[n]) for n in MULTI_PIE[::-1]))
    with pytest.raises(ValueError, match="another order"):
        read_landmarks(path, face)


def test_one_pair_exchanged_and_an_order_shifted_by_one_are_refused(face, tmp_path):
    six = dict.fromkeys(("eye_left_outer", "eye_right_outer", "chin", "nose_tip"))
    at = {n: face.landmarks[n] for n in (*six, "mouth_corner_left", "mouth_corner_right")}
    at["mouth_corner_left"], at["mouth_corner_right"] = (
        at["mouth_corner_right"],
        at["mouth_corner_left"],
    )
    path = write(tmp_path, "a.json", json.dumps(at))
    with pytest.raises(
        ValueError, match="mouth_corner_left and mouth_corner_right stand the other"
    ):
        read_landmarks(path, face)
    order = [face.landmarks[n] for n in (*MULTI_PIE[1:], MULTI_PIE[0])]
    path = write(tmp_path, "a.txt", "\n".join(map(str, order)))
    with pytest.raises(ValueError, match="landmarks stand in another order"):
        read_landmarks(path, face)


@pytest.mark.parametrize("kind", ["named", "bare", "header", "json"])
def test_points_are_read_from_text_and_json(face, tmp_path, kind):
    points = dict(zip(MULTI_PIE, points_of(face).tolist(), strict=True))
    lines = {n: " ".join(f"{c:.4f}" for c in p) for n, p in points.items()}
    text = {
        "named": "\n".join(f"{n}, {line.replace(' ', ', ')}" for n, line in lines.items()),
        "bare": "\n".join(lines.values()),
        "header": "name x y z\n" + "\n".join(f"{n} {line}" for n, line in lines.items()),
        "json": json.dumps(points),
    }[kind]
    name = "a.json" if kind == "json" else "a.csv"
    assert read_landmarks(write(tmp_path, name, text), face) == face.landmarks


def test_meshlab_with_decimal_commas_is_read(face, tmp_path):
    text = picked(face)
    for axis in "xyz":
        text = re.sub(rf'{axis}="([^"]*)"', lambda m: m[0].replace(".", ","), text)
    assert read_landmarks(write(tmp_path, "a.pp", text), face) == face.landmarks


def test_names_are_given_for_lists_in_an_order_of_their_own(face, tmp_path):
    path = write(tmp_path, "a.npy", npy(np.array([3, 4, 5], dtype=np.uint16)))
    with pytest.raises(ValueError, match=r"3 landmarks without names.*names="):
        read_landmarks(path, face)
    assert read_landmarks(path, face, names=["a", "b", "c"]) == {"a": 3, "b": 4, "c": 5}
    with pytest.raises(ValueError, match="names has 2"):
        read_landmarks(path, face, names=["a", "b"])
    with pytest.raises(TypeError, match="names='abc'"):
        read_landmarks(path, face, names="abc")
    with pytest.raises(ValueError, match="a stand"):
        read_landmarks(path, face, names=["a", "b", "a"])


@pytest.mark.parametrize(
    "name, data, words",
    [
        ("a.obj", b"v", "unknown kind of landmarks; readable are .ljson"),
        ("a.txt", b"nose_tip\n", "line 1: 'nose_tip' is neither"),
        ("a.txt", b"nose 3\n4\n", "line 2: some landmarks have a name and others none"),
        ("a.txt", b"nose 99999\n", "nose is vertex 99999, but the mesh has 0 to 4374"),
        ("a.txt", b"nose -1\n", "nose is vertex -1"),
        ("a.txt", b"# none\n", "no vertices in it"),
        ("a.ljson", b'{"version": 4}', "version is 4, but must be a whole number, 1 to 3"),
        ("a.ljson", b'{"version": 2, "landmarks": {"points": [[1, 2]]}}', "picture have no depth"),
        ("a.ljson", b'{"version": 2, "landmarks": {"points": []}}', "no points"),
        ("a.ljson", b'{"version": 3, "groups": {}}', "0 groups of landmarks"),
        ("a.pp", b"<PickedPoints></PickedPoints>", "no picked points"),
        ("a.pp", b'<PickedPoints><point name="a" x="1" y="b" z="2"/></PickedPoints>', "y='b'"),
        ("a.pp", b'<!DOCTYPE a [<!ENTITY b "c">]><PickedPoints/>', "defines entities"),
        ("a.npy", npy(np.array([1.5])), "it holds float64"),
        ("a.npy", npy(np.array([None])), "pickled objects, which are never read"),
        ("a.npz", npz(a=np.zeros(3)), "it holds a; wanted are one array of triangles"),
        ("a.npz", npz(face=np.array([0]), bary=np.array([[2.0, 0, 0]])), "weights of landmark 0"),
        ("a.npz", npz(face=np.array([10**6]), bary=np.array([[1.0, 0, 0]])), "triangle 1000000"),
    ],
)
def test_what_is_no_file_of_landmarks_is_refused(face, tmp_path, name, data, words):
    with pytest.raises(ValueError, match=words) as error:
        read_landmarks(write(tmp_path, name, data), face)
    assert name in str(error.value)


def test_what_is_no_path_or_no_mesh_is_refused(face, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file of landmarks"):
        read_landmarks(tmp_path / "a.pp", face)
    with pytest.raises(TypeError, match="mesh is a ndarray"):
        read_landmarks(tmp_path / "a.pp", face.vertices)


def test_two_landmarks_at_one_vertex_are_said(tmp_path):
    mesh = TriangleMesh([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2]])
    path = write(tmp_path, "a.txt", "a 1\nb 1\nc 2\n")
    with pytest.warns(UserWarning, match=r"at one vertex are a and b\."):
        assert read_landmarks(path, mesh) == {"a": 1, "b": 1, "c": 2}


def test_what_was_written_is_read_again(face, tmp_path):
    write_landmarks(tmp_path / "m.ljson", face.vertices, face.landmarks)
    assert read_landmarks(tmp_path / "m.ljson", face) == face.landmarks
    with pytest.raises(ValueError, match="landmarks is empty"):
        write_landmarks(tmp_path / "m.ljson", face.vertices, {})
    with pytest.raises(ValueError, match=r"landmarks\['chin'\]=9999"):
        write_landmarks(tmp_path / "m.ljson", face.vertices, {"chin": 9999})


@pytest.mark.parametrize(
    "spell",
    [
        str.upper,
        lambda n: n.replace("left", "L").replace("right", "R"),
        lambda n: f"Actor:{n}",
        lambda n: n.replace("_", "-").title(),
        lambda n: f"{MULTI_PIE.index(n)}_{n}",
    ],
)
def test_names_in_another_spelling_are_spelled_as_the_house_does(face, tmp_path, spell):
    lines = [f"{spell(n)} {face.landmarks[n]}\n" for n in MULTI_PIE]
    (tmp_path / "m.txt").write_text("".join(lines) + "Ear 7\n")
    found = read_landmarks(tmp_path / "m.txt", face)
    assert found == {n: face.landmarks[n] for n in MULTI_PIE} | {"Ear": 7}


def test_sides_exchanged_are_refused_in_any_spelling(face, tmp_path):
    swap = {"L": "R", "R": "L"}
    lines = [
        f"{re.sub('[LR]', lambda m: swap[m[0]], n.replace('left', 'L').replace('right', 'R'))} "
        f"{face.landmarks[n]}\n"
        for n in MULTI_PIE
    ]
    (tmp_path / "m.txt").write_text("".join(lines))
    with pytest.raises(ValueError, match="left and right are exchanged"):
        read_landmarks(tmp_path / "m.txt", face)


def test_two_names_that_read_alike_are_refused_with_their_file(face, tmp_path):
    (tmp_path / "m.txt").write_text("A:chin 3\nB:chin 4\n")
    with pytest.raises(ValueError, match=r"m\.txt: 'A:chin', 'B:chin' all read like the landmark"):
        read_landmarks(tmp_path / "m.txt", face)
