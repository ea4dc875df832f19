"""The procedural face: topology, proportions, and likeness to the generic face."""

import json
import os
from collections import Counter
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from crossings import angles, self_intersections
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from data_synth.actors import ACTORS
from data_synth.anatomy import Anatomy
from data_synth.identity import random_identity
from data_synth.template import build_template, layout
from data_synth.template.layout import layout_mesh

DENSE, SPARSE = 8820, 4375


@pytest.fixture(scope="module", params=[DENSE, SPARSE])
def face(request):
    return build_template(n_vertices=request.param)


@pytest.fixture(scope="module", params=sorted(ACTORS))
def actor(request):
    return build_template(ACTORS[request.param].anatomy)


def edge_counts(faces):
    """Undirected edges (k, 2) and in how many faces each lies (k,)."""
    edges = np.sort(np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def boundary_components(faces):
    """Vertex sets of the boundary's connected pieces."""
    edges, counts = edge_counts(faces)
    rim = edges[counts == 1]
    n = faces.max() + 1
    _, label = connected_components(coo_array((np.ones(len(rim)), rim.T), shape=(n, n)))
    ids = np.unique(rim)
    return [set(ids[label[ids] == k]) for k in np.unique(label[ids])]


# --- topology ---------------------------------------------------------------------------


def test_vertex_count_is_met_exactly_and_every_vertex_is_used(face):
    assert len(face.vertices) in (DENSE, SPARSE)
    np.testing.assert_array_equal(np.unique(face.faces), np.arange(len(face.vertices)))
    assert face.vertices.dtype == np.float64


def test_mesh_is_a_manifold_in_one_piece_with_consistent_orientation(face):
    _, counts = edge_counts(face.faces)
    assert counts.max() == 2
    directed = np.vstack([face.faces[:, [0, 1]], face.faces[:, [1, 2]], face.faces[:, [2, 0]]])
    assert len(np.unique(directed, axis=0)) == len(directed)
    n = len(face.vertices)
    graph = coo_array((np.ones(len(directed)), directed.T), shape=(n, n))
    assert connected_components(graph)[0] == 1
    # a disc with three openings: V - E + F = 1 - 3
    assert n - len(counts) + len(face.faces) == -2
    corners = face.vertices[face.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert normals[:, 2].sum() > 0  # outward: the face looks forward


def test_the_openings_are_two_eyes_the_mouth_and_the_outer_border(face):
    c = face.curves
    expected = [
        set(c["upper_lid_inner_left"]) | set(c["lower_lid_inner_left"]),
        set(c["upper_lid_inner_right"]) | set(c["lower_lid_inner_right"]),
        set(c["upper_lip_roll"]) | set(c["lower_lip_roll"]),
        set(c["border"]),
    ]
    found = boundary_components(face.faces)
    assert len(found) == 4
    for rim in expected:
        assert rim in found


def test_curves_follow_mesh_edges(face):
    edges, _ = edge_counts(face.faces)
    known = set(map(tuple, edges))
    for name, line in face.curves.items():
        steps = set(map(tuple, np.sort(np.stack([line[:-1], line[1:]], 1), axis=1)))
        assert steps <= known, name
    for side in ("left", "right"):
        upper, lower = (face.curves[f"{part}_lid_{side}"] for part in ("upper", "lower"))
        assert upper[0] == lower[0] and upper[-1] == lower[-1]  # both lids end at the canthi


def test_symmetry_is_exact(actor):
    mirrored = actor.vertices[actor.mirror] * [-1.0, 1.0, 1.0]
    np.testing.assert_array_equal(mirrored, actor.vertices)
    np.testing.assert_array_equal(actor.mirror[actor.mirror], np.arange(len(actor.mirror)))
    middle = actor.mirror == np.arange(len(actor.mirror))
    assert (actor.vertices[middle, 0] == 0.0).all()
    assert (actor.vertices[~middle, 0] != 0.0).all()
    flipped = np.sort(actor.mirror[actor.faces], axis=1)
    assert set(map(tuple, flipped)) == set(map(tuple, np.sort(actor.faces, axis=1)))
    names = {name.replace("left", "right") for name in actor.regions if name.endswith("left")}
    for name in names:
        left = actor.regions[name.replace("right", "left")]
        assert set(actor.mirror[left]) == set(actor.regions[name])


def test_topology_does_not_depend_on_the_anatomy(actor):
    average = build_template()
    np.testing.assert_array_equal(actor.faces, average.faces)
    np.testing.assert_array_equal(actor.landmarks, average.landmarks)
    assert np.abs(actor.vertices - average.vertices).max() > 3.0


def test_regions_cover_the_face_without_overlap(face):
    counts = Counter(np.concatenate(list(face.regions.values())).tolist())
    assert set(counts) == set(range(len(face.vertices)))
    assert max(counts.values()) == 1
    wanted = {"forehead", "glabella", "nose", "upper_lip", "lower_lip", "chin"}
    wanted |= {
        f"{part}_{side}"
        for side in ("left", "right")
        for part in ("brow", "upper_lid", "lower_lid", "cheek", "jaw", "temple", "nostril")
    }
    assert wanted <= set(face.regions)  # fmt: skip
    assert min(len(v) for v in face.regions.values()) >= 4


def test_results_are_copies_that_a_caller_may_change():
    first = build_template(n_vertices=SPARSE)
    first.faces[:] = 0
    first.vertices[:] = 0.0
    assert build_template(n_vertices=SPARSE).faces.max() == SPARSE - 1


# --- quality ----------------------------------------------------------------------------


def test_triangles_are_even_for_every_actor(actor):
    smallest = angles(actor.vertices, actor.faces).min(1)
    assert np.mean(smallest >= 15.0) >= 0.99


def test_triangles_are_even_at_both_densities(face):
    smallest = angles(face.vertices, face.faces).min(1)
    assert np.mean(smallest >= 15.0) >= 0.99


def test_no_actor_intersects_itself(actor):
    # the halves are mirror images, so one half, kept on its side, is enough
    off = actor.vertices[:, 0] >= 0.0
    assert (actor.vertices[actor.mirror > np.arange(len(actor.mirror)), 0] > 0.0).all()
    half = actor.faces[off[actor.faces].all(1)]
    assert len(half) == len(actor.faces) // 2
    assert len(self_intersections(actor.vertices, half)) == 0


def test_the_intersection_test_can_fail():
    face = build_template(n_vertices=SPARSE)
    vertices = face.vertices.copy()
    vertices[face.landmarks[66]] += [0.0, 4.0, 0.0]  # lower lip pushed through the upper
    assert len(self_intersections(vertices, face.faces)) > 0


def test_no_skin_lies_inside_an_eyeball(actor):
    for centre, radius in actor.eyeballs.values():
        assert np.linalg.norm(actor.vertices - centre, axis=1).min() > radius


def test_the_inner_corner_of_the_eye_is_closed_by_skin_before_the_ball(actor):
    for side in ("left", "right"):
        centre, radius = actor.eyeballs[side]
        rim = actor.vertices[actor.curves[f"upper_lid_inner_{side}"][0]] - centre
        # seen from the front the edge of the skin lies well within the ball's outline,
        # and close to the ball, so that no view shows what is behind
        assert np.hypot(rim[0], rim[1]) < 0.95 * radius and rim[2] > 0.0
        assert np.linalg.norm(rim) - radius < 1.0


# --- proportions ------------------------------------------------------------------------


def test_landmarks_keep_the_measurements_of_each_actor(actor):
    a, p = actor.anatomy, actor.vertices[actor.landmarks]

    def breadth(i, j):
        return abs(p[j, 0] - p[i, 0])

    # folds and fairness move the skin a little: 0.6 mm; free skin more: 1.5 mm
    assert breadth(39, 42) == pytest.approx(a.intercanthal_width, abs=0.6)
    assert breadth(36, 45) == pytest.approx(a.biocular_width, abs=0.8)
    assert breadth(48, 54) == pytest.approx(a.mouth_width, rel=0.03)
    assert p[27, 1] - p[33, 1] == pytest.approx(a.nose_height, abs=0.6)
    assert np.linalg.norm(p[30] - p[33]) == pytest.approx(a.nasal_protrusion, abs=0.8)
    assert p[33, 1] - p[51, 1] == pytest.approx(a.philtrum_length, abs=0.6)
    vermilion = a.upper_vermilion_height + a.lower_vermilion_height
    assert p[51, 1] - p[57, 1] == pytest.approx(vermilion, abs=0.6)
    assert p[62, 1] - p[66, 1] == pytest.approx(a.lip_gap, abs=0.2)
    nose = actor.vertices[actor.regions["nose"]]
    wings = nose[(nose[:, 1] < p[30, 1]) & (nose[:, 2] > p[33, 2] - 7.0), 0]
    assert wings.max() - wings.min() == pytest.approx(a.nose_width, abs=1.5)
    level = np.abs(actor.vertices[:, 1] + 15.0) < 8.0
    assert 2 * actor.vertices[level, 0].max() > a.bizygomatic_width


def test_landmarks_stand_in_multi_pie_order():
    face = build_template()
    p = face.vertices[face.landmarks]
    assert len(set(face.landmarks)) == 68
    assert (np.diff(p[:17, 0]) > 0).all()  # from the person's right ear to the left
    assert p[8, 0] == 0.0 and p[8, 1] == p[:17, 1].min()
    assert (np.diff(p[17:27, 0]) > 0).all()
    assert (p[27:31, 0] == 0.0).all() and (np.diff(p[27:31, 1]) < 0).all()
    assert (np.diff(p[31:36, 0]) > 0).all() and p[33, 0] == 0.0
    for first in (36, 42):  # outer or inner corner, upper lid, other corner, lower lid
        eye = p[first : first + 6]
        assert (np.diff(eye[:4, 0]) > 0).all() and eye[1:3, 1].min() > eye[4:, 1].max()
    assert (np.diff(p[48:55, 0]) > 0).all() and (np.diff(p[54:60, 0]) < 0).all()
    assert (np.diff(p[60:65, 0]) > 0).all() and (p[61:64, 1] > p[[67, 66, 65], 1]).all()
    twins = face.mirror[face.landmarks]
    assert set(twins) == set(face.landmarks)


def test_one_measurement_moves_its_own_place():
    average = build_template(n_vertices=SPARSE)
    wide = build_template(Anatomy(nose_width=39.0), n_vertices=SPARSE)
    shift = np.linalg.norm(wide.vertices - average.vertices, axis=1)
    assert shift[average.regions["nose"]].max() > 1.5
    assert shift[average.regions["chin"]].max() < 0.3
    assert shift[average.regions["forehead"]].max() < 0.3


def test_jaw_axis_lies_behind_the_face():
    face = build_template(n_vertices=SPARSE)
    point, direction = face.jaw_axis
    assert point[2] < face.vertices[:, 2].min()
    np.testing.assert_array_equal(direction, [1.0, 0.0, 0.0])


def test_actors_differ_in_shape_and_not_only_in_size():
    names = sorted(ACTORS)
    shapes = []
    for name in names:
        vertices = build_template(ACTORS[name].anatomy, n_vertices=SPARSE).vertices
        vertices = vertices - vertices.mean(0)
        shapes.append(vertices * np.sqrt(len(vertices)) / np.linalg.norm(vertices) * 60.0)
    for i in range(4):
        for j in range(i):
            rms = np.sqrt(((shapes[i] - shapes[j]) ** 2).sum(1).mean())
            assert rms > 1.5, (names[i], names[j])


@pytest.mark.parametrize("seed", range(6))
def test_random_identities_are_sound_and_repeatable(seed):
    anatomy = random_identity(seed)
    assert anatomy == random_identity(seed)
    assert anatomy != random_identity(seed + 100)
    face = build_template(anatomy, n_vertices=SPARSE)
    assert np.mean(angles(face.vertices, face.faces).min(1) >= 15.0) >= 0.99
    half = face.faces[(face.vertices[face.faces, 0] >= 0.0).all(1)]
    assert len(self_intersections(face.vertices, half)) == 0


@pytest.mark.parametrize("seed", [3, 22, 25, 26])  # lids of these nearly touch
def test_difficult_random_identities_are_sound_when_dense(seed):
    face = build_template(random_identity(seed))
    half = face.faces[(face.vertices[face.faces, 0] >= 0.0).all(1)]
    assert len(self_intersections(face.vertices, half)) == 0
    for centre, radius in face.eyeballs.values():
        assert np.linalg.norm(face.vertices - centre, axis=1).min() > radius


# --- likeness to a scan -----------------------------------------------------------------


def read_scan(root):
    """Narrow face of ICT-FaceKit's neutral mesh: vertices in mm, triangles, landmarks."""
    model = Path(root) / "FaceXModel"
    vertices, faces = [], []
    for line in (model / "generic_neutral_mesh.obj").read_text().splitlines():
        if line.startswith("v "):
            vertices.append([10.0 * float(x) for x in line.split()[1:4]])  # file has cm
        elif line.startswith("f "):
            ring = [int(x.split("/")[0]) - 1 for x in line.split()[1:]]
            if max(ring) < 6706:
                faces += [[ring[0], ring[k], ring[k + 1]] for k in range(1, len(ring) - 1)]
    path = next(Path(root).rglob("vertex_indices.json"))
    landmarks = json.loads(path.read_text())["idx_to_landmark_verts"]
    return np.array(vertices[:6706]), np.array(faces), np.array(landmarks)


def surface_distance(points, vertices, faces, n=6):
    """Distance of points from a triangle mesh, from above: to a dense sample of it."""
    weights = np.array([[i, j, n - i - j] for i in range(n + 1) for j in range(n + 1 - i)]) / n
    sample = np.einsum("kc,fcd->fkd", weights, vertices[faces]).reshape(-1, 3)
    return cKDTree(sample).query(points)[0]


@pytest.mark.real
def test_average_face_is_near_a_scanned_face():
    root = os.environ.get("FACELAB_ICT")
    if not root or not Path(root).is_dir():
        pytest.skip("FACELAB_ICT does not name a folder with ICT-FaceKit")
    vertices, faces, landmarks = read_scan(root)
    face = build_template()
    x, y = face.vertices[face.landmarks], vertices[landmarks]
    # similarity from landmarks (both faces stand upright, so no reflection can arise)
    x0, y0 = x - x.mean(0), y - y.mean(0)
    u, s, vt = np.linalg.svd(x0.T @ y0)
    scale = s.sum() / (x0**2).sum()
    assert np.linalg.det(u @ vt) > 0
    aligned = scale * (face.vertices - x.mean(0)) @ (u @ vt) + y.mean(0)
    distance = surface_distance(aligned, vertices, faces)
    assert distance.mean() < 2.5
    assert np.quantile(distance, 0.95) < 6.0


# --- refusals ---------------------------------------------------------------------------


@pytest.mark.parametrize("count", [0, 500, 10**6])
def test_vertex_counts_out_of_range_are_refused(count):
    with pytest.raises(ValueError, match=rf"n_vertices={count} .*1500.*use 4375 or 8820"):
        build_template(n_vertices=count)


def test_wrong_kinds_are_refused():
    with pytest.raises(TypeError, match="n_vertices must be an integer"):
        build_template(n_vertices=8820.0)
    with pytest.raises(TypeError, match="anatomy must be an Anatomy"):
        build_template({"nose_width": 30.0})
    with pytest.raises(TypeError, match="nose_width must be a number"):
        Anatomy(nose_width="wide")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nose_width": 90.0}, r"nose_width=90.0 is outside .*Stay near"),
        ({"mouth_width": float("nan")}, "mouth_width=nan is outside"),
        ({"bizygomatic_width": 120.0, "bigonial_width": 130.0}, "bigonial_width=130.0 must stay"),
        ({"biocular_width": 76.0, "intercanthal_width": 38.0}, "palpebral fissure of 19 mm"),
        ({"interpupillary_distance": 75.0}, "puts the eyeball outside its lids"),
    ],
)
def test_impossible_anatomies_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Anatomy(**changes)


def test_all_bad_measurements_are_named_at_once():
    with pytest.raises(ValueError, match=r"(?s)nose_width=1\.0.*chin_width=500\.0|chin_width=500\.0"
                                         r".*nose_width=1\.0"):  # fmt: skip
        Anatomy(nose_width=1.0, chin_width=500.0)


def test_every_measurement_does_something():
    average = build_template(n_vertices=SPARSE)
    for field in fields(Anatomy):
        # a step upward, or downward where the default lies near its upper limit
        step = 0.03 * abs(field.default) if abs(field.default) > 3 else 0.4
        face = build_template(replace(Anatomy(), **{field.name: field.default + step}), SPARSE)
        moved = np.abs(face.vertices - average.vertices).max()
        assert moved > 0.02 or field.name == "eyeball_radius", field.name


def test_the_mesh_does_not_depend_on_the_number_of_threads(tmp_path, monkeypatch):
    made = []
    for threads in (1, 2):
        monkeypatch.setenv("FACELAB_CACHE", str(tmp_path / str(threads)))  # made, not kept
        layout_mesh.cache_clear()
        with threadpool_limits(threads):
            made.append(build_template(n_vertices=3000))
    np.testing.assert_array_equal(made[0].vertices, made[1].vertices)
    np.testing.assert_array_equal(made[0].faces, made[1].faces)


def test_a_kept_mesh_is_the_made_one_and_one_of_another_density_is_not_taken(tmp_path, monkeypatch):
    def fails(_):
        raise RuntimeError("made again")

    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))
    get = layout_mesh.__wrapped__
    made = layout._laid_out(1500)
    get(1500)
    monkeypatch.setattr(layout, "_laid_out", fails)
    kept = get(1500)
    for name in ("places", "faces"):
        assert getattr(kept, name).tobytes() == made[name].tobytes()
        assert getattr(kept, name).dtype == made[name].dtype
    assert kept.landmarks == dict(made["landmarks"])
    for name, line in kept.lines.items():
        np.testing.assert_array_equal(line, made[f"lines.{name}"])
    assert len(kept.lines) == len(made) - 3
    (tmp_path / "layouts" / "1500").rename(tmp_path / "layouts" / "1600")
    with pytest.raises(RuntimeError, match="made again"):
        get(1600)
