import re
import struct

import numpy as np
import pytest
import trimesh
from mutants import COUNT, tally
from shapes import grid_mesh, sphere_mesh

from facelab.files import read_mesh, read_parts, write_ply
from facelab.files.ply import read_ply_file
from facelab.files.stl import read_stl_file


@pytest.fixture
def write(tmp_path):
    """Write text or bytes to a file and give its path."""

    def write(content, name):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def ball():
    return sphere_mesh(1, radius=80.0)


def export(mesh, path, **options):
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path, **options)
    return path


# --- PLY ------------------------------------------------------------------------------------------


def test_a_ply_written_and_read_again_keeps_order_and_faces(tmp_path, ball):
    write_ply(tmp_path / "ball.ply", ball)
    again = read_mesh(tmp_path / "ball.ply")
    np.testing.assert_allclose(again.vertices, ball.vertices, atol=1e-5)  # float32 near 80
    np.testing.assert_array_equal(again.faces, ball.faces)
    other = trimesh.load(tmp_path / "ball.ply", process=False)  # a second reader
    np.testing.assert_array_equal(other.faces, ball.faces)
    np.testing.assert_allclose(other.vertices, ball.vertices, atol=1e-5)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_plys_of_others_keep_order_and_faces(tmp_path, ball, encoding):
    again = read_mesh(export(ball, tmp_path / "a.ply", encoding=encoding))
    np.testing.assert_allclose(again.vertices, ball.vertices, atol=1e-5)
    np.testing.assert_array_equal(again.faces, ball.faces)


HEAD = """ply
format ascii 1.0
comment by hand
element vertex 5
property float x
property float y
property float z
property uchar red
element face 2
property uchar flag
property list uchar int vertex_indices
property list uchar float texcoord
element tristrips 1
property list int int vertex_indices
end_header
"""
POINTS = [(0, 0, 0, 1), (1, 0, 0, 2), (1, 1, 0, 3), (0, 1, 0, 255), (0, 0, 1, 0)]
STRIPS = [0, 1, 2, 3, -1, 0, 1, 2, 3, 4]
EXPECTED = [[0, 1, 2], [0, 2, 3], [0, 1, 4], [0, 1, 2], [2, 1, 3], [0, 1, 2], [2, 1, 3], [2, 3, 4]]


def everything(form):
    """A file with all that PLY has: uneven lists, lists and numbers mixed, strips; and its kind."""
    if form == "ascii":
        rows = [*(" ".join(map(str, p)) for p in POINTS), "7 4 0 1 2 3 0", "1 3 0 1 4 2 .5 .5"]
        return (HEAD + "\n".join([*rows, "10 " + " ".join(map(str, STRIPS))]) + "\n").encode()
    e = "<" if "little" in form else ">"
    data = HEAD.replace("ascii", form).encode()
    data += b"".join(struct.pack(e + "fffB", *p) for p in POINTS)
    data += struct.pack(e + "BB4iB", 7, 4, 0, 1, 2, 3, 0)
    data += struct.pack(e + "BB3iB2f", 1, 3, 0, 1, 4, 2, 0.5, 0.5)
    return data + struct.pack(e + "i10i", 10, *STRIPS)


FORMS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("form", FORMS)
def test_polygons_strips_and_all_that_stands_beside_them_are_read(write, form):
    held = read_ply_file(write(everything(form), "all.ply"))
    assert held.faces.tolist() == EXPECTED  # every second triangle of a strip runs the other way
    np.testing.assert_array_equal(held.vertices, np.array(POINTS)[:, :3])


def test_a_strip_becomes_triangles_that_face_the_same_way(write):
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    head += "property float z\nelement tristrips 1\nproperty list int int vertex_indices\n"
    path = write(head + "end_header\n0 0 0\n90 0 0\n0 90 0\n90 90 0\n5 0 1 2 3 -1\n", "strip.ply")
    mesh = read_mesh(path)
    assert mesh.faces.tolist() == [[0, 1, 2], [2, 1, 3]]
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 4)


def test_a_corner_that_a_strip_turns_round_has_no_area_and_goes(write):
    text = everything("ascii").replace(b"10 0 1 2 3 -1 0 1 2 3 4", b"6 0 1 1 2 2 3")
    assert len(read_ply_file(write(text, "turn.ply")).faces) == 3


def test_a_concave_quad_is_cut_inside(write):
    text = PLY.replace("1 1 0", "0.2 0.2 0") + "4 3 0 1 2\n"
    assert read_mesh(write(text, "quad.ply")).face_areas.sum() == pytest.approx(0.2)


PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
0 1 0
"""


def test_quads_of_a_ply_become_triangles(write):
    mesh = read_mesh(write(PLY + "4 0 1 2 3\n", "quad.ply"))
    assert mesh.n_vertices == 4
    assert mesh.face_areas.sum() == pytest.approx(1)
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 4)


@pytest.mark.parametrize(
    "text, words",
    [
        (PLY, "the file ends early: .* 1 rows of 'face', and 0 rows are left"),
        (PLY + "4 0 1 2\n", "row 0 of 'face', '4 0 1 2', has not as many values"),
        (PLY + "3 0 1 2 3\n", "row 0 of 'face', .* has not as many values"),
        (PLY + "3 0 1 9\n", "face 0: vertex 9 is not among 0 to 3"),
        (PLY + "3 0 1 -1\n", "face 0: vertex -1 is not among 0 to 3"),
        (PLY + "3 0 1 1\n", "face 0: it uses a vertex twice"),
        (PLY + "2 0 1\n", r"face 0: it has 2 corner\(s\)"),
        (PLY + "3 0 1 1.5\n", "row 0 of 'face' has '1.5', which is no whole number of its type"),
        (PLY + "300 0 1 2\n", "row 0 of 'face' has '300', which is no whole number"),
        (PLY.replace("1 1 0", "1 nan 0") + "4 0 1 2 3\n", "vertex 2: .* NaN"),
        (PLY.replace("1 1 0", "1 1e300 0") + "4 0 1 2 3\n", "vertex 2: .* beyond"),
        (PLY.replace("1 1 0", "1 1_0 0") + "4 0 1 2 3\n", "row 2 of 'vertex' has '1_0', which is"),
        (PLY.replace("1 1 0", "1 1.2.3 0") + "4 0 1 2 3\n", "row 2 of 'vertex' has '1.2.3'"),
        (PLY.replace("1 1 0", "1 1") + "4 0 1 2 3\n", "row 2 of 'vertex', '1 1', has not as many"),
        (PLY.replace("face 1", "face 2") + "4 0 1 2 3\n", "ends early: .* 2 rows of 'face'"),
        (PLY + "4 0 1 2 3\n3 0 1 2\n", "1 rows follow the last row"),
        (PLY.replace("face 1", "face 0"), "4 vertices but no triangles"),
        (PLY.replace("float z", "float y") + "4 0 1 2 3\n", "line 6: .* 'y' is there twice"),
        (
            PLY.replace("float z", "flaot z") + "4 0 1 2 3\n",
            "line 6: .* is no line of a PLY header",
        ),
        (PLY.replace("float z", "float w") + "4 0 1 2 3\n", "no element 'vertex' with the prop"),
        (PLY.replace("vertex_indices", "corners") + "4 0 1 2 3\n", "has no list 'vertex_indices'"),
        (PLY.replace("ascii", "text") + "4 0 1 2 3\n", "line 2: .* the format is one of ascii"),
        (PLY.replace("vertex 4", "vertex -4"), "line 3: .* is no line of a PLY header"),
        ("ply\n", "not a PLY file"),
        ("no mesh", "not a PLY file"),
    ],
)
def test_a_ply_that_cannot_be_used_is_refused_by_name_and_row(write, text, words):
    with pytest.raises(ValueError, match=rf"bad\.ply.*{words}"):
        read_mesh(write(text, "bad.ply"))


def test_bad_faces_of_a_ply_are_left_out_on_wish(write):
    path = write(PLY.replace("face 1", "face 2") + "3 0 1 1\n4 0 1 2 3\n", "bad.ply")
    with pytest.warns(UserWarning, match="1 of 2 faces are left out: face 0: it uses a vertex"):
        assert len(read_mesh(path, bad_faces="leave out").faces) == 2


@pytest.mark.parametrize("count", [10**6, 10**14])
@pytest.mark.parametrize("name", ["vertex", "face"])
@pytest.mark.parametrize("form", FORMS)
def test_a_ply_takes_no_memory_for_rows_that_it_does_not_have(write, form, name, count):
    data = re.sub(rb"element %s \d+" % name.encode(), b"element %s %d" % (name.encode(), count),
                  everything(form))  # fmt: skip
    with pytest.raises(ValueError, match="the file ends early: the header promises"):
        read_mesh(write(data, "huge.ply"))


@pytest.mark.parametrize("form", FORMS[1:])
def test_a_list_longer_than_the_file_is_refused(write, form):
    data = everything(form)
    e = "<" if "little" in form else ">"
    data = data.replace(struct.pack(e + "i10i", 10, *STRIPS), struct.pack(e + "i", 2**31 - 1))
    with pytest.raises(ValueError, match=r"row 0 of 'tristrips' does not fit into the file"):
        read_mesh(write(data, "huge.ply"))


@pytest.mark.parametrize("form", FORMS)
def test_mutants_of_a_ply_are_refused_in_our_words_or_read_as_they_stand(tmp_path, rng, form):
    def contradicts(held, data, said):
        """Counts of the header, indices, values."""
        counts = dict(re.findall(rb"element (\w+) (\d+)", data))
        if len(held.vertices) != int(counts[b"vertex"]):
            return "other number of vertices"
        if not np.isfinite(held.vertices).all() or np.ptp(held.faces) >= len(held.vertices):
            return "values or indices out of range"
        other = [
            w for w in (b"x", b"y", b"z") if not re.search(rb"property \w+ " + w + rb"\s", data)
        ]
        return f"no property {other}" if other else ""

    found = tally(read_ply_file, everything(form), "a.ply", tmp_path, COUNT, rng, contradicts)
    assert not found.wrong and not found.python, found


# --- STL ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_an_stl_is_read_as_loose_triangles_that_weld_to_the_surface(tmp_path, ball, kind):
    soup = read_mesh(export(ball, tmp_path / "a.stl", file_type=kind))
    assert soup.n_vertices == 3 * len(ball.faces)
    mesh, index = soup.welded()
    assert (mesh.n_vertices, len(mesh.faces)) == (ball.n_vertices, len(ball.faces))
    np.testing.assert_array_equal(mesh.vertices[index], soup.vertices)
    np.testing.assert_allclose(
        mesh.vertices[mesh.faces], ball.vertices[ball.faces], atol=1e-5
    )  # the order of the triangles is the file's


def test_the_advice_for_loose_triangles_is_to_weld_them(tmp_path, ball):
    soup = read_mesh(export(ball, tmp_path / "a.stl"))
    with pytest.raises(ValueError, match=r"80 pieces of 3, .*; .* use mesh.welded\(\)\[0\]\."):
        soup.subsample(20)


SOLID = """solid {name}
  facet normal 0 0 1
    outer loop
      vertex 0 0 0
      vertex {x} 0 0
      vertex 0 100.5 0
    endloop
  endfacet
endsolid {name}
"""
TWO = SOLID.format(name="Upper Lip", x="1e2") + SOLID.format(name="chin", x="120")


def test_solids_are_parts(write):
    path = write(TWO, "two.stl")
    assert [m.vertices[1, 0] for m in read_parts(path).values()] == [100, 120]
    assert list(read_parts(path)) == ["Upper Lip", "chin"]
    assert read_mesh(path, mesh="chin").n_vertices == 3
    with pytest.raises(ValueError, match="mesh='nose' is not in it; its parts are 'Upper Lip'"):
        read_mesh(path, mesh="nose")


def test_capitals_and_normals_that_are_no_numbers_do_not_matter(write):
    text = TWO.upper().replace("NORMAL 0 0 1", "NORMAL NAN NAN NAN").replace("\n", "\r\n")
    assert len(read_mesh(write(text, "loud.stl")).faces) == 2


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("endsolid chin\n", "", "it ends without 'endsolid'"),
        ("vertex 120 0 0", "vertex 120 0", "line 14: 'vertex 120 0' stands where 'vertex' and"),
        ("vertex 120", "vertex 1_20", "line 14: .* stands where 'vertex' and three numbers"),
        ("vertex 120", "vertex inf", "line 14: .* stands where 'vertex' and three numbers"),
        ("vertex 120", "vertex 1e99", "triangle 1: the coordinates .* beyond"),
        ("vertex 120 0 0", "", "line 15: 'vertex 0 100.5 0'|line 16: 'endloop' stands where 'vert"),
        (
            "endloop\n  endfacet\nendsolid chin",
            "endsolid chin",
            "line 16: .* where 'endloop'",
        ),
        ("endloop\n  endfacet\nendsolid chin", "", "it ends within a triangle"),
        (
            "endsolid Upper Lip\n",
            "",
            "line 9: 'solid chin' .* or 'endsolid' is wanted",
        ),
        ("solid Upper", "# by hand\nsolid Upper", "begins with '# by hand', so it is no STL file"),
        ("endsolid Upper Lip\n", "endsolid Upper Lip\nvertex 0 0 0\n", "line 10: there is more"),
    ],
)
def test_a_text_stl_that_is_broken_is_refused_by_line(write, old, new, words):
    assert old in TWO
    with pytest.raises(ValueError, match=rf"bad\.stl.*({words})"):
        read_mesh(write(TWO.replace(old, new), "bad.stl"))


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: "\n \t\n" + text,
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace("\n", " "),
        lambda text: text.replace("\n  facet", " facet"),
        lambda text: text.replace("normal 0 0 1", "normal -1.#IND 0 1"),
    ],
    ids=["mark of UTF-8", "blank lines", "CR", "one line", "names and facets", "#IND"],
)
def test_a_text_stl_is_read_however_its_words_are_set(write, change):
    parts = read_parts(write(change(TWO), "a.stl"))
    assert list(parts) == ["Upper Lip", "chin"]
    assert [m.vertices[1, 0] for m in parts.values()] == [100, 120]


def test_a_text_stl_in_two_bytes_to_a_letter_is_refused_as_that(tmp_path):
    (tmp_path / "a.stl").write_bytes(TWO.encode("utf-16"))
    with pytest.raises(ValueError, match="UTF-16 text; save it as UTF-8"):
        read_mesh(tmp_path / "a.stl")


@pytest.mark.parametrize("header", [b"made by hand", b"solid by hand"])
@pytest.mark.parametrize("change", [lambda d: d[:-1], lambda d: d + b"\0\0", lambda d: d[:90]])
def test_a_binary_stl_of_another_size_than_it_promises_is_refused(tmp_path, ball, change, header):
    path = export(ball, tmp_path / "a.stl")
    path.write_bytes(change(header.ljust(80, b" ") + path.read_bytes()[80:]))
    with pytest.raises(ValueError, match=r"a.stl: not a whole STL file: \d+ bytes, but its header"):
        read_mesh(path)


@pytest.mark.parametrize("count", [0, 0xFFFFFFFF])
def test_a_count_that_was_never_written_is_taken_from_the_size(tmp_path, ball, count):
    data = bytearray(export(ball, tmp_path / "a.stl").read_bytes())
    struct.pack_into("<I", data, 80, count)
    (tmp_path / "a.stl").write_bytes(data)
    with pytest.warns(UserWarning, match=f"counts {count} triangles, .* that of {len(ball.faces)}"):
        assert len(read_mesh(tmp_path / "a.stl").faces) == len(ball.faces)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_mutants_of_an_stl_are_refused_in_our_words_or_read_as_they_stand(tmp_path, rng, kind):
    def contradicts(held, data, said):
        promised = struct.unpack_from("<I", data, 80)[0]
        if not np.isfinite(held.vertices).all():
            return "not finite"
        if len(data) == 84 + 50 * promised:
            return "" if len(held.faces) == promised else "other number of triangles"
        n = len(re.findall(rb"(?i)\bvertex\b", data))
        return "" if len(held.vertices) == n else "other number of corners"

    mesh = grid_mesh(5, 4, spacing=40.0)
    data = export(mesh, tmp_path / "b.stl", file_type=kind).read_bytes()
    found = tally(read_stl_file, data, "a.stl", tmp_path, COUNT, rng, contradicts)
    assert not found.wrong and not found.python, found


@pytest.mark.parametrize("part", [0.02, 0.1, 0.3, 0.5, 0.9, 0.99, 0.999])
@pytest.mark.parametrize(
    "name, options",
    [
        ("a.ply", {}),
        ("a.ply", {"encoding": "ascii"}),
        ("a.stl", {}),
        ("a.stl", {"file_type": "stl_ascii"}),
    ],
)
def test_a_file_cut_short_is_refused(tmp_path, ball, name, options, part):
    path = export(ball, tmp_path / name, **options)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(ValueError, match=re.escape(str(path))):
        read_mesh(path)
