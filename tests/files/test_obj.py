import warnings

import numpy as np
import pytest
from mutants import COUNT, tally
from shapes import grid_mesh, sphere_mesh

from facelab.files.meshes import read_mesh, read_parts
from facelab.files.obj import read_obj, read_obj_file, read_obj_vertices, write_obj

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
SQUARE = TRIANGLE + "v 1 1 0\n"


@pytest.fixture
def write(tmp_path):
    """Write text or bytes to a file and give its path."""

    def write(content, name="face.obj"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


# --- OBJ ------------------------------------------------------------------------------------------


def test_an_obj_written_and_read_again_is_the_same_mesh(tmp_path, rng):
    mesh = sphere_mesh(2, radius=80.0)
    mesh = mesh.with_vertices(mesh.vertices * rng.uniform(1e-3, 1e3, size=mesh.vertices.shape))
    write_obj(tmp_path / "a.obj", mesh)
    again = read_obj(tmp_path / "a.obj")
    np.testing.assert_allclose(again.vertices, mesh.vertices, rtol=1e-8)  # nine digits are written
    np.testing.assert_array_equal(again.faces, mesh.faces)


@pytest.mark.parametrize(
    "faces, expected",
    [
        ("f 1 2 4 3", [[0, 1, 3], [0, 3, 2]]),
        ("f 4 3 1\nf 1 2 4", [[3, 2, 0], [0, 1, 3]]),
        ("f 1/1 2/2 4/3", [[0, 1, 3]]),
        ("f 1/1/1 2/2/1 4/3/1", [[0, 1, 3]]),
        ("f 1//1 2//1 4//1", [[0, 1, 3]]),
        ("f -4 -3 -1", [[0, 1, 3]]),
        ("f -4/-1 -3/-1 4", [[0, 1, 3]]),
        ("f 1 2 4 # the lower one", [[0, 1, 3]]),
        ("f 1 2 \\\n4", [[0, 1, 3]]),
        ("f 1 2 \\\r\n4 \\\r\n3", [[0, 1, 3], [0, 3, 2]]),
        ("  f\t1  2 4  ", [[0, 1, 3]]),
        ("f 1 2 4 \\", [[0, 1, 3]]),
        ("g lips\nusemtl skin\ns off\nf 1 2 4\no eye", [[0, 1, 3]]),
    ],
)
def test_faces_of_every_form_are_read(write, faces, expected):
    mesh = read_obj(write(SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\n" + faces))
    assert mesh.faces.tolist() == expected
    assert mesh.n_vertices == 4


def test_a_polygon_becomes_a_fan_that_covers_it_and_faces_the_same_way(write):
    angle = 2 * np.pi * np.arange(7) / 7
    corners = "".join(
        f"v {x:.9f} {y:.9f} 0\n" for x, y in np.stack([np.cos(angle), np.sin(angle)], axis=1)
    )
    mesh = read_obj(write(corners + "f 1 2 3 4 5 6 7\n"))
    assert mesh.faces.tolist() == [[0, i, i + 1] for i in range(1, 6)]
    assert mesh.face_areas.sum() == pytest.approx(3.5 * np.sin(2 * np.pi / 7))  # a heptagon's
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 7, atol=1e-9)


def test_relative_indices_count_back_from_their_own_line(write):
    text = TRIANGLE + "f -3 -2 -1\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf -3 -2 -1\n"
    assert read_obj(write(text)).faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_faces_may_stand_before_their_vertices(write):
    assert read_obj(write("f 1 2 3\n" + TRIANGLE)).faces.tolist() == [[0, 1, 2]]


def test_uv_seams_do_not_split_or_reorder_vertices(write):
    uv = "vt 0 0\nvt 1 0\nvt 0 1\nvt .9 0\nvt 0 .9\nvt 1 1\n"  # the shared edge has two of each
    mesh = read_obj(write(SQUARE + uv + "f 1/1 2/2 3/3\nf 2/4 4/6 3/5\n"))
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"], ids=["unix", "windows", "old mac"])
def test_every_line_ending_is_understood(write, newline):
    text = "# made by hand\n\n" + TRIANGLE + "# faces\nf 1 2 3\n"
    mesh = read_obj(write(text.replace("\n", newline)))
    assert (mesh.n_vertices, mesh.faces.tolist()) == (3, [[0, 1, 2]])


def test_a_byte_order_mark_does_not_hide_the_first_vertex(write):
    mesh = read_obj(write(b"\xef\xbb\xbf" + (SQUARE + "f 1 2 3\n").encode()))
    assert mesh.n_vertices == 4
    np.testing.assert_array_equal(mesh.vertices[1], [1, 0, 0])


def test_colours_and_weights_after_the_coordinates_are_passed_over(write):
    text = "v 1 2 3 .5 .5 .5\nv 4 5 6 1\nv 7 8 10 # last\nf 1 2 3"
    np.testing.assert_array_equal(
        read_obj(write(text)).vertices, [[1, 2, 3], [4, 5, 6], [7, 8, 10]]
    )


def test_vertices_alone_are_those_of_the_mesh(write):
    path = write(SQUARE + "f 1 2 3\n")
    np.testing.assert_array_equal(read_obj_vertices(path), read_obj(path).vertices)


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "face.obj' is empty"),
        (b"glTF\x02\0\0\0\x10", "face.obj: this is a binary file"),
        ("hello\n", "face.obj: no vertices"),
        (TRIANGLE, "face.obj: vertices but no faces"),
        (TRIANGLE + "f 1 2", "face.obj, line 4: a face with 2 corner"),
        (TRIANGLE + "f", "face.obj, line 4: a face with 0 corner"),
        (TRIANGLE + "f 1 2 3\nf 1 2 4", "face.obj, line 5: index 4 is out of range.*3 vertices"),
        (TRIANGLE + "f 0 1 2", "face.obj, line 4: index 0 is out of range"),
        (TRIANGLE + "f -4 1 2", "face.obj, line 4: index -4 is out of range"),
        ("v 0 0 0\nf -1 -2 -3\nv 1 0 0\nv 0 1 0", "line 2: index -2 is out of range"),
        (TRIANGLE + "f 1 2 x", "face.obj, line 4: 'f 1 2 x' is not a list of indices"),
        (TRIANGLE + "f 1.5 2 3", "face.obj, line 4: .* is not a list of indices"),
        (TRIANGLE + "f 1 / 3", "face.obj, line 4: .* is not a list of indices"),
        (TRIANGLE + "f 1 2 2", "face.obj, line 4: the face uses a vertex twice"),
        (TRIANGLE + "f 1 2 3 1", "face.obj, line 4: the face uses a vertex twice"),
        (TRIANGLE + "f 1 2 -2", "face.obj, line 4: the face uses a vertex twice"),
        (TRIANGLE + "v nan 0 0\nf 1 2 3", "face.obj, line 4: 'v nan 0 0' holds NaN"),
        (TRIANGLE + "v 0 inf 0\nf 1 2 3", "face.obj, line 4: .* holds NaN or infinity"),
        (TRIANGLE + "v 0 1e999 0\nf 1 2 3", "face.obj, line 4: .* holds NaN or infinity"),
        (TRIANGLE + "v 0 0\nf 1 2 3", "face.obj, line 4: 'v 0 0' has not three coordinates"),
        ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3", "face.obj, line 1: .* has not three coordinates"),
        ("v\nv\nv\nf 1 2 3", "face.obj, line 1: 'v' has not three coordinates"),
        (TRIANGLE + "v 0 zero 0\nf 1 2 3", "face.obj, line 4: 'v 0 zero 0' holds no numbers"),
        (TRIANGLE + "v 0,5 0 0\nf 1 2 3", "face.obj, line 4: .* has decimal commas"),
        ("v 0 0 \\\n0\n\nv 1 0 0\nv 0 1 x\nf 1 2 3", "face.obj, line 5: 'v 0 1 x'"),
    ],
)
def test_an_obj_that_cannot_be_used_is_refused_with_its_place(write, text, words):
    with pytest.raises(ValueError, match=words):
        read_obj(write(text))


@pytest.mark.parametrize("read", [read_obj, read_obj_vertices, read_mesh])
def test_a_missing_file_is_refused_by_name(tmp_path, read):
    with pytest.raises(FileNotFoundError, match=r"nowhere.obj.*there is no such"):
        read(tmp_path / "nowhere.obj")


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(ValueError, match="is not a file; give the path of one OBJ file"):
        read_obj(tmp_path)


# --- bad faces, unknown words, parts --------------------------------------------------------------

BAD = [
    ("f 4 4 1", "line 6: the face uses a vertex twice"),
    ("f 1 2", r"line 6: a face with 2 corner\(s\)"),
    ("f 1 2 9", "line 6: index 9 is out of range"),
]


@pytest.mark.parametrize("face, words", BAD)
def test_a_bad_face_is_refused_by_line_or_left_out_with_a_warning_that_names_it(write, face, words):
    path = write(SQUARE + "f 1 2 3\n" + face + "\nf 2 4 3\n")
    with pytest.raises(ValueError, match=words + '.*; remove it, or give bad_faces="leave out"'):
        read_obj(path)
    with pytest.warns(UserWarning, match="1 of 3 faces are left out: " + words):
        mesh = read_obj(path, bad_faces="leave out")
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]
    assert mesh.n_vertices == 4


def test_all_bad_faces_are_named_at_once(write):
    path = write(SQUARE + "f 1 2 3\nf 1 1 2\nf 1 2 9\nf 1 2\n")
    with pytest.raises(ValueError, match=r"line 6: .*twice \(so are line 7, line 8\)"):
        read_obj(path)


def test_a_mesh_of_bad_faces_alone_is_refused_either_way(write):
    with pytest.raises(ValueError, match="line 5: the face uses a vertex twice; remove it"):
        read_obj(write(SQUARE + "f 1 1 2\n"), bad_faces="leave out")


def test_what_to_do_about_bad_faces_is_one_of_two(write):
    with pytest.raises(ValueError, match="bad_faces='drop' is unknown; choose one of 'refuse'"):
        read_obj(write(SQUARE + "f 1 2 3\n"), bad_faces="drop")


def test_unknown_keywords_are_counted_and_said(write):
    path = write("wobble a b\n" + SQUARE + "f 1 2 3\nhair on\nhair off\n")
    with pytest.warns(
        UserWarning, match=r"3 line\(s\) with keywords .*'hair', 'wobble'; .* line 1"
    ):
        assert read_obj(path).n_vertices == 4


@pytest.mark.parametrize("line", ["w 0 0 0", "0 0 0", "vv 1 2 3", "e 1/1 2/2 3/3", "1.5"])
def test_data_under_an_unknown_keyword_are_refused_for_they_would_shift_the_others(write, line):
    with pytest.raises(ValueError, match=r"face.obj, line 5: .* looks like data, but OBJ has no"):
        read_obj(write(SQUARE + line + "\nf 1 2 3\n"))


def test_every_keyword_of_the_format_is_passed_over_in_silence(write):
    path = write("")
    path.with_name("a.mtl").write_text("newmtl m\nKd 1 0 0\n")
    words = "mtllib a.mtl\no a\ng b c\ns 1\nusemtl m\nvp 0 1\nl 1 2\np 1\nvt 0 0\nvn 0 0 1\n"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_obj(write(words + SQUARE + "f 1/1/1 2/1/1 3/1/1\n"))


@pytest.mark.parametrize("face", ["f 1/1 2/2 3/1", "f 1//1 2//1 3//2", "f 1/-2 2/-1 3/-1"])
def test_texture_coordinates_and_normals_that_are_not_there_are_said(write, face):
    with pytest.warns(
        UserWarning, match=r"1 face\(s\) name texture coordinates or normals.*line 7"
    ):
        read_obj(write(SQUARE + "vt 0 0\nvn 0 0 1\n" + face + "\n"))


def test_corners_of_different_form_are_said(write):
    with pytest.warns(UserWarning, match=r"1 face\(s\) give texture .* some of their .* line 6"):
        mesh = read_obj(write(SQUARE + "vt 0 0\nf 1/1 2 3/1\n"))
    assert mesh.faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    "line", ["v 1_0 0 0", "v 0 0 0 0 0", "v 0 0 0 x", "v ١ 0 0", "v 1.2.3 0 0", "v 0x1 0 0"]
)
def test_what_only_python_takes_for_a_number_is_none(write, line):
    with pytest.raises(ValueError, match=r"face.obj, line 5: "):
        read_obj(write(SQUARE + line + "\nf 1 2 3\n"))
    with pytest.raises(ValueError, match=r"face.obj, line 5: "):
        read_obj_vertices(write(SQUARE + line + "\nf 1 2 3\n"))


def test_a_coordinate_that_no_length_has_is_refused(write):
    with pytest.raises(ValueError, match=r"face.obj, line 5: .* beyond 1e\+12"):
        read_obj(write(SQUARE + "v 1e300 0 0\nf 1 2 3\n"))


def test_objects_and_groups_are_parts_of_their_own_in_the_order_of_the_file(write):
    far = "v 9 0 0\nv 40 0 0\nv 9 31 0\nv 40 31 0\n"
    text = f"o Head\n{SQUARE}g lips\nf 1 2 3\ng skin\nf 2 4 3\no Eye\n{far}g\nf 7 6 5\n"
    path = write(text)
    assert {n: len(f) for n, f in read_obj_file(path).parts.items()} == {
        "Head": 2,
        "Eye": 1,
        "lips": 1,
        "skin": 1,
    }
    eye = read_mesh(path, mesh="Eye")
    assert eye.faces.tolist() == [[2, 1, 0]]
    np.testing.assert_array_equal(eye.vertices, read_obj(path).vertices[4:7])
    with pytest.raises(
        ValueError, match=r"mesh='Nose' is not in it; its parts are 'Head' \(4 vert"
    ):
        read_mesh(path, mesh="Nose")


def test_surfaces_that_are_no_polygons_are_told(write):
    path = write(SQUARE + "f 1 2 3\ncstype bezier\ndeg 1 1\nsurf 0 1 0 1 1 2 3 4\nend\n")
    with pytest.warns(UserWarning, match=r"face\.obj: 1 curve.* are not read, the first in line 8"):
        assert len(read_obj(path).faces) == 1


def test_a_number_sign_within_a_name_begins_no_comment(write):
    text = "g head#1 # the left\nf 1 2 3\ng head#2\nf 2 4 3 #half\n"
    assert {n: len(m.faces) for n, m in read_parts(write(SQUARE + text)).items()} == {
        "head#1": 1,
        "head#2": 1,
    }


def test_a_file_without_parts_says_so(write):
    with pytest.raises(ValueError, match="mesh='Head' is not in it; it has no named parts, leave"):
        read_mesh(write(SQUARE + "f 1 2 3\n"), mesh="Head")


# --- concave polygons -----------------------------------------------------------------------------


def test_a_quad_that_bends_inwards_is_cut_along_the_diagonal_inside(write):
    corners = "v 2 0 0\nv 0.4 0.4 0\nv 0 2 0\nv 0 0 0\n"
    for turn in range(4):
        face = "f " + " ".join(str((k + turn) % 4 + 1) for k in range(4))
        mesh = read_obj(write(corners + face + "\n"))
        assert mesh.face_areas.sum() == pytest.approx(0.8)
        assert (mesh.normals[:, 2] > 0.99).all()


# --- speed path, real files -----------------------------------------------------------------------


@pytest.mark.parametrize("form", ["{}", " {}", "{} # note", "{}\\\n"])
def test_vertices_alone_are_the_same_however_the_lines_are_set(write, form):
    text = "".join(form.format(line) + "\n" for line in SQUARE.splitlines()) + "f 1 2 3\n"
    np.testing.assert_array_equal(
        read_obj_vertices(write(text)), read_obj(write(SQUARE + "f 1 2 3\n")).vertices
    )


@pytest.mark.real
def test_the_concave_quads_of_the_generic_face_are_cut_inside(ict_root):
    mesh = read_obj(ict_root / "FaceXModel" / "generic_neutral_mesh.obj")
    assert (mesh.n_vertices, len(mesh.faces)) == (26719, 52220)


# --- mutants --------------------------------------------------------------------------------------


def obj_mesh():
    """A small scan as programs write it: polygons, texture coordinates, normals, groups."""
    mesh = grid_mesh(6, 5, spacing=30.0)
    lines = ["# a scan", "mtllib scan.mtl", "o Scan"]
    lines += [f"v {x:.4f} {y:.4f} {x * y / 1e3:.4f}" for x, y, _ in mesh.vertices]
    lines += [f"vt {x / 150:.4f} {y / 120:.4f}" for x, y, _ in mesh.vertices]
    lines += ["vn 0.0 0.0 1.0", "g skin", "usemtl skin", "s 1"]
    for row in range(4):
        for k in range(5):
            a = 6 * row + k + 1
            lines.append("f " + " ".join(f"{c}/{c}/1" for c in (a, a + 1, a + 7, a + 6)))
    return "\n".join(lines).encode() + b"\n"


def obj_contradicts(mesh, data, said):
    """What the file itself denies: counts of lines, indices, values; another way of reading it."""
    if said:
        return ""
    V, F = [], []
    for line in map(bytes.decode, data.splitlines(), ["latin-1"] * len(data)):
        words = line.split("#")[0].split()
        if words[:1] == ["v"]:
            V.append([float(w) for w in words[1:4]])
        elif words[:1] == ["f"]:
            F.append([int(w.split("/")[0]) for w in words[1:]])
        elif words and words[0] not in ("vt", "vn", "g", "usemtl", "s", "o", "mtllib"):
            if words[0] not in ("l", "p", "end", "vp", "sp"):
                return f"passes over {line!r}"
    if not np.isfinite(mesh.vertices).all() or not np.array_equal(mesh.vertices, V):
        return "other vertices"
    if len(mesh.faces) != sum(len(f) - 2 for f in F):
        return "other faces"
    if sorted(set(np.ravel(mesh.faces) + 1)) != sorted({c % (len(V) + 1) for f in F for c in f}):
        return "other indices"
    return ""


def test_mutants_of_an_obj_are_refused_in_our_words_or_read_as_they_stand(tmp_path, rng):
    found = tally(read_obj, obj_mesh(), "scan.obj", tmp_path, COUNT, rng, obj_contradicts)
    assert not found.wrong and not found.python, found
