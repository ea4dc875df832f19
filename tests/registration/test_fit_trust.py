"""What a fit says of itself, and what it refuses."""

import re
import warnings
from itertools import pairwise

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import facelab
from data_synth.identity import random_identity
from data_synth.template import build_template
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.registration import fit_markers, fit_scan, rest_markers
from facelab.registration.landmarks import check_landmarks, judge
from facelab.registration.report import crossings, folds
from facelab.registration.scan import on_border, without_scraps, wound_outwards

N = 1500  # vertices: coarse, to be quick


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    with threadpool_limits(1):
        yield


def face_of(anatomy=None):
    face = build_template(anatomy, n_vertices=N)
    return TriangleMesh(
        face.vertices, face.faces, dict(zip(MULTI_PIE, face.landmarks.tolist(), strict=True))
    )


@pytest.fixture(scope="module")
def template():
    return face_of()


@pytest.fixture(scope="module")
def scan():
    return face_of(random_identity(5))


@pytest.fixture(scope="module")
def glued():
    """Names and places of the markers of an actor at rest."""
    capture = facelab.data.load_capture("F2", size="small", progress=False)
    positions, names = rest_markers([capture.markers(t) for t in capture.texts])
    return positions, list(names)


def places(mesh, names=MULTI_PIE):
    return mesh.vertices[[mesh.landmarks[n] for n in names]]


def other_side(name):
    return re.sub("left|right", lambda m: {"left": "right", "right": "left"}[m[0]], name)


def order_of(kind, rng, names):
    """Names spoilt in a way: which place each of them gets."""
    n = len(names)
    at, order = {name: i for i, name in enumerate(names)}, np.arange(n)
    if kind == "shifted":
        return np.roll(order, rng.integers(1, n))
    if kind == "backwards":
        return order[::-1]
    if kind == "shuffled":
        return rng.permutation(n)
    if kind == "two":
        i = rng.integers(n)
        far = np.flatnonzero(np.abs(order - i) > 3)
        j = rng.choice(far)
        order[[i, j]] = j, i
        return order
    sided = [name for name in names if name.startswith(kind) and other_side(name) in at]
    for name in sided:
        order[at[name]] = at[other_side(name)]
    return order


KINDS = {
    "shifted": r"another order than the places, shifted by \d+ place",
    "backwards": "another order than the places, backwards",
    "shuffled": "fit no face|lie far",
    "two": "are exchanged|far from",
    "eye": "exchanged in the names of eye_",
    "brow": "exchanged in the names of brow_",
    ("lip", "mouth"): "exchanged in the names of lip_..., mouth_...",
    ("eye", "brow"): "exchanged in the names of brow_..., eye_...",
    ("brow", "eye", "nostril", "lip", "mouth"): "exchanged in the names of brow",
    "": "left and right are exchanged in all names",
}


# --- the judge of landmarks -----------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_names_that_are_wrong_are_refused_in_words(kind, template, rng):
    for seed in range(4):
        face = face_of(random_identity(seed))
        order = order_of(kind, rng, MULTI_PIE)
        with pytest.raises(ValueError, match=KINDS[kind]):
            check_landmarks(places(template), places(face)[order], MULTI_PIE, "marks")


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_far_off_are_named_and_no_others(count, template, rng):
    for seed in range(4):
        target = places(face_of(random_identity(seed)))
        some = rng.choice(len(target), count, replace=False)
        away = rng.normal(size=(count, 3))
        target[some] += 60 * away / np.linalg.norm(away, axis=1, keepdims=True)
        with pytest.raises(ValueError) as refused:
            check_landmarks(places(template), target, MULTI_PIE, "marks")
        text = str(refused.value)
        assert text.startswith("marks: ") and "far from where" in text
        named = set(re.findall(r"(\w+) \(\d+ mm\)", text))
        assert named == {MULTI_PIE[i] for i in some}


def test_right_landmarks_are_never_refused(template, rng):
    for seed in range(30):
        target = places(face_of(random_identity(seed)))
        target += rng.normal(size=target.shape)  # placed by hand
        some = np.sort(rng.choice(len(target), rng.integers(6, 69), replace=False))
        names = [MULTI_PIE[i] for i in some]
        judged = check_landmarks(places(template)[some], target[some], names, "marks")
        assert judged.doubt.max() < 3


def test_how_far_a_landmark_lies_off_does_not_depend_on_frame_or_size(template, scan):
    source, target = places(template), places(scan)
    turn = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    off = judge(source, target, MULTI_PIE).off
    np.testing.assert_allclose(judge(source, target @ turn.T + 70, MULTI_PIE).off, off, atol=1e-9)
    np.testing.assert_allclose(judge(source, 1.2 * target, MULTI_PIE).off, 1.2 * off, atol=1e-9)


def test_a_landmark_is_foretold_as_if_it_had_not_been_seen(template, scan):
    source, target = places(template), places(scan)
    moved = target.copy()
    moved[8] += [3, -2, 4]
    here, there = (judge(source, t, MULTI_PIE).expected[8] for t in (target, moved))
    assert np.linalg.norm(here - there) < 0.3  # nothing but the alignment knows of it


@pytest.mark.parametrize(
    ("k", "unit"),
    [
        (0.001, "metres: multiply by 1000"), (0.1, "centimetres: multiply by 10"),
        (10, "tenths of a millimetre: multiply by 0.1"), (1 / 25.4, "inches: multiply by 25.4"),
        (1 / 304.8, "feet: multiply by 304.8"), (3, "Scale it to millimetres"),
    ],
)  # fmt: skip
def test_the_wrong_unit_is_told_with_the_factor(k, unit, template, scan, glued):
    with pytest.raises(ValueError, match=unit):
        fit_scan(template, scan.with_vertices(scan.vertices * k))
    with pytest.raises(ValueError, match=unit):
        fit_markers(template, glued[0] * k, glued[1])


def test_a_mirrored_scan_is_told_from_exchanged_names(template, scan):
    negated = scan.with_vertices(scan.vertices * [1, 1, -1])
    with pytest.raises(ValueError, match=r"mirrored.*wound inwards"):
        fit_scan(template, negated)
    renamed = {other_side(name): v for name, v in scan.landmarks.items()}
    with pytest.raises(ValueError, match="left and right are exchanged in all names"):
        fit_scan(template, TriangleMesh(scan.vertices, scan.faces, renamed))


def test_markers_say_which_names_are_exchanged(template, glued):
    positions, names = glued
    with pytest.raises(ValueError, match="exchanged in the names of brow"):
        fit_markers(template, positions, [other_side(n) if "brow" in n else n for n in names])
    with pytest.raises(ValueError, match="mirrored, or left and right are exchanged in all"):
        fit_markers(template, positions, [other_side(n) for n in names])


@pytest.mark.parametrize("by", [1, -1, 2])
def test_names_that_slip_along_the_list_are_told_though_some_are_no_landmarks(by, template, glued):
    positions, names = glued
    slipped = [*names[by:], *names[:by]]
    with pytest.raises(ValueError, match=rf"another order than the places, shifted by {abs(by)} "):
        fit_markers(template, positions, slipped)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda P: P * np.nan, "no marker that was seen"),
        (lambda P: np.where(np.arange(len(P))[:, None] == 3, np.inf, P), "infinite"),
        (lambda P: P * 0 + 5, "one line|one place"),
        (lambda P: P * [1, 1, 0], "flattened"),
    ],
)
def test_markers_that_say_nothing_are_refused(template, glued, spoil, message):
    with pytest.raises(ValueError, match=message):
        fit_markers(template, spoil(glued[0]), glued[1])


def test_what_is_no_mesh_is_refused(template, scan):
    with pytest.raises(TypeError, match="scan is a ndarray"):
        fit_scan(template, scan.vertices)
    with pytest.raises(TypeError, match="template is a ndarray"):
        fit_markers(template.vertices, np.zeros((1, 3)), ["chin"])
    flat = TriangleMesh(scan.vertices * [1, 0, 0], scan.faces, scan.landmarks)
    with pytest.raises(ValueError, match="no area"):
        fit_scan(template, flat)


def spelled(name, how):
    sided = name.replace("left", "L").replace("right", "R")
    return {"caps": name.upper(), "sides": sided, "prefix": f"Actor1:{sided}"}[how]


@pytest.mark.parametrize("how", ["caps", "sides", "prefix"])
def test_names_of_landmarks_are_known_in_any_spelling(template, scan, how):
    marks = {spelled(n, how): v for n, v in scan.landmarks.items()}
    fit = fit_scan(template, TriangleMesh(scan.vertices, scan.faces, marks))
    right = fit_scan(template, scan)
    assert fit.landmarks == right.landmarks == tuple(MULTI_PIE)
    np.testing.assert_allclose(fit.mesh.vertices, right.mesh.vertices, atol=1e-9)
    some = [spelled(n, how) for n in MULTI_PIE[::3]]
    given = fit_scan(template, scan, landmarks=some)
    assert given.landmarks == tuple(MULTI_PIE[::3])
    names = [*map(spelled, MULTI_PIE, [how] * 68), "ghost"]
    points = np.vstack([places(scan), places(scan)[:1] + [0, 0, 200]])
    with pytest.warns(UserWarning, match=r"ghost \("):
        fit = fit_markers(template, points, names)
    assert fit.landmarks == tuple(MULTI_PIE) and fit.names == tuple(names[:-1])
    assert fit.used.all() and fit.left_out.keys() == {"ghost"}
    right = fit_markers(template, places(scan), MULTI_PIE)
    np.testing.assert_allclose(fit.mesh.vertices, right.mesh.vertices, atol=1e-9)
    assert fit.report.landmarks == pytest.approx(right.report.landmarks)


def test_a_name_without_side_is_no_landmark_of_a_side(template, scan):
    names = [n.replace("left_", "") if n.startswith("jaw_left") else n for n in MULTI_PIE]
    fit = fit_markers(template, places(scan), names)
    assert not any(n.startswith("jaw_left") for n in fit.landmarks) and len(fit.landmarks) == 60


def test_two_names_that_read_like_one_landmark_are_refused(template, scan):
    names = ["CHIN" if n == "chin" else "Chin" if n == "jaw_left_1" else n for n in MULTI_PIE]
    with pytest.raises(ValueError, match="'CHIN', 'Chin' all read like the landmark 'chin'; give"):
        fit_markers(template, places(scan), names)


@pytest.mark.parametrize("kind", ["markers", "scan"])
def test_landmarks_of_the_middle_line_alone_are_refused(template, scan, kind):
    middle = [n for n in MULTI_PIE if other_side(n) == n]
    with pytest.raises(
        ValueError, match=r"\(chin, .*\) lie on one plane.*Add .* mouth_corner_left"
    ):
        if kind == "scan":
            fit_scan(template, scan, landmarks=middle)
        else:
            fit_markers(template, places(scan, middle), middle)


# --- scans ----------------------------------------------------------------------------------------


def other_way(scan, turned):
    faces = scan.faces.copy()
    faces[turned] = faces[turned][:, ::-1]
    return TriangleMesh(scan.vertices, faces, scan.landmarks)


@pytest.mark.parametrize(
    ("turned", "said"),
    [
        (lambda c, rng: np.ones(len(c), dtype=bool), "all its triangles"),
        (lambda c, rng: c[:, 0] > 0, "of its triangles"),
        (lambda c, rng: rng.random(len(c)) < 0.3, "of its triangles"),
    ],
)
def test_triangles_wound_inwards_are_turned_with_a_word(template, scan, rng, turned, said):
    wrong = other_way(scan, turned(scan.vertices[scan.faces].mean(axis=1), rng))
    with pytest.warns(UserWarning, match=said):
        mended = wound_outwards(wrong, template)
    outward = np.sort(np.sort(scan.faces, axis=1), axis=0)
    np.testing.assert_array_equal(np.sort(np.sort(mended.faces, axis=1), axis=0), outward)
    np.testing.assert_allclose(mended.normals, scan.normals, atol=1e-12)


def test_pieces_of_a_scan_are_turned_one_by_one(template, scan):
    left = scan.vertices[scan.faces].mean(axis=1)[:, 0] > 0
    cut = np.unique(scan.faces[left])
    new = np.full(N, -1)
    new[cut] = N + np.arange(len(cut))
    faces = scan.faces.copy()
    faces[left] = new[faces[left]][:, ::-1]  # a piece of its own, apart, and inwards
    V = np.vstack([scan.vertices, scan.vertices[cut] + [0.5, 0, 0]])
    two = TriangleMesh(V, faces, scan.landmarks)
    with pytest.warns(UserWarning, match="of its triangles"):
        mended = wound_outwards(two, template)
    assert (mended.faces[~left] == faces[~left]).all()
    assert (mended.faces[left] == faces[left][:, ::-1]).all()


def test_a_scan_that_is_wound_inwards_is_fitted_as_the_other(template, scan):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        right = fit_scan(template, scan)
    with pytest.warns(UserWarning, match="wound inwards"):
        turned = fit_scan(template, other_way(scan, slice(None)))
    np.testing.assert_allclose(turned.mesh.vertices, right.mesh.vertices, atol=1e-6)
    assert turned.report.drawn > 0.9


def scattered(scan, rng, count=40):
    """The scan with loose scraps of four points in front of it."""
    heart = scan.vertices[rng.integers(N, size=count)] + rng.normal(size=(count, 3)) * 6
    more = (heart[:, None] + rng.normal(size=(count, 4, 3))).reshape(-1, 3)
    corners = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]])
    extra = (corners[None] + N + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
    V = np.vstack([scan.vertices, more])
    return TriangleMesh(V, np.vstack([scan.faces, extra]), scan.landmarks)


def test_scraps_are_left_out_with_a_word(scan, rng):
    with pytest.warns(UserWarning, match="40 loose piece.* of 120 triangles"):
        left = without_scraps(scattered(scan, rng), list(scan.landmarks.values()))
    np.testing.assert_array_equal(left.faces, scan.faces)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert without_scraps(scan, []) is scan


def test_a_heap_of_loose_triangles_is_one_surface(scan):
    corners = scan.faces.ravel()
    marks = {n: int(np.flatnonzero(corners == v)[0]) for n, v in scan.landmarks.items()}
    heap = TriangleMesh(scan.vertices[corners], np.arange(len(corners)).reshape(-1, 3), marks)
    rim = np.unique(np.concatenate(scan.boundary_loops))
    np.testing.assert_array_equal(on_border(heap), np.isin(corners, rim))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert without_scraps(heap, []) is heap and wound_outwards(heap, scan) is heap


def test_a_ball_is_no_face(template):
    theta, phi = np.meshgrid(np.linspace(0.05, 3.09, 50), np.linspace(0, 2 * np.pi, 81)[:-1])
    points = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    V = 90 * points.reshape(3, -1).T + [0, -30, -60]
    faces = tube(80, 50)
    ball = TriangleMesh(V, faces)
    marks = {
        n: int(np.linalg.norm(V - template.vertices[v], axis=1).argmin())
        for n, v in template.landmarks.items()
    }
    with pytest.raises(ValueError, match=r"bends by \d+ degrees.*no face"):
        fit_scan(template, TriangleMesh(ball.vertices, faces, marks))


def tube(rows, columns):
    """Triangles of a tube of rows x columns vertices, its ends open."""
    i = np.arange(rows)[:, None] * columns
    j = np.arange(columns - 1)[None]
    a, b = i + j, np.roll(i, -1, axis=0) + j
    quads = np.stack([a, a + 1, b + 1, b], axis=-1).reshape(-1, 4)
    return np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def test_little_of_a_face_is_said(template, scan):
    with pytest.warns(UserWarning, match=r"only \d+ % of the template is drawn"):
        fit = fit_scan(template, scan.submesh(scan.vertices[:, 0] < -8))
    r = fit.report
    assert r.drawn < 0.5 and r.n_used + r.n_unused == N
    assert r.unused_rms > 20  # the missing half is centimetres away


# --- the report -----------------------------------------------------------------------------------


def test_a_report_counts_ghosts_and_how_far_they_lie(template, glued):
    positions, names = glued
    far = positions.mean(axis=0) + [[0, 0, 300], [0, 250, 0]]
    with pytest.warns(UserWarning, match=r"ghost_\d \(\d+ mm\)"):
        fit = fit_markers(template, np.vstack([positions, far]), [*names, "ghost_1", "ghost_2"])
    clean = fit_markers(template, positions, names)
    r = fit.report
    assert (r.n_used, r.n_unused) == (len(names), 2)
    assert r.unused_max > 100 and r.rms == pytest.approx(clean.report.rms, abs=0.1)
    assert "2 not used" in repr(fit)
    assert not clean.report.n_unused and np.abs(fit.mesh.vertices - clean.mesh.vertices).max() < 1


@pytest.mark.parametrize("far", [300, 3000, 1e300, 1e308])
def test_a_marker_that_is_not_at_the_face_is_left_out_by_name(template, glued, far):
    positions, names = glued
    with pytest.warns(UserWarning, match=r"1 of \d+ lie.*left out.*ghost \(\S+ mm\)"):
        fit = fit_markers(template, np.vstack([positions, [far, 0, 0]]), [*names, "ghost"])
    assert list(fit.left_out) == ["ghost"] and fit.names == tuple(names)
    assert np.array_equal(fit.mesh.vertices, fit_markers(template, *glued).mesh.vertices)


@pytest.mark.parametrize("away", [[300, 0, 0], [0, 0, 600], [2000, 500, 0]])
def test_a_second_head_does_not_pull_at_the_first(template, glued, away):
    positions, names = glued
    both = np.vstack([positions, positions + away])
    second = [f"{name}_2" for name in names]
    with pytest.warns(UserWarning, match=f"{len(names)} of {2 * len(names)} lie.*somebody else"):
        fit = fit_markers(template, both, [*names, *second])
    clean = fit_markers(template, *glued)
    assert set(fit.left_out) == set(second) and fit.report.n_unused == len(second)
    assert np.abs(fit.mesh.vertices - clean.mesh.vertices).max() < 1e-9
    with pytest.warns(UserWarning, match="somebody else"):
        loud = fit_markers(template, both[::-1], [n.upper() for n in (*names, *second)][::-1])
    assert np.abs(loud.mesh.vertices - clean.mesh.vertices).max() < 1e-6
    assert set(loud.left_out) == {name.upper() for name in second}


def test_a_body_does_not_pull_at_the_head(template, glued, rng):
    positions, names = glued
    body = positions.mean(axis=0) + [0, -400, 0] + rng.uniform(-200, 200, (3 * len(names), 3))
    with pytest.warns(UserWarning, match="left out"):
        fit = fit_markers(
            template, np.vstack([positions, body]), [*names, *map(str, range(len(body)))]
        )
    assert len(fit.left_out) == len(body) and fit.report.rms < 1


def test_a_crowd_too_near_to_tell_is_refused(template, glued):
    positions, names = glued
    both = np.vstack([positions, positions + [0, 0, 20]])
    with pytest.raises(ValueError, match=r"off the face.*too near to tell whose.*_2 \(\d+ mm\)"):
        fit_markers(template, both, [*names, *(f"{name}_2" for name in names)])


def test_a_report_says_how_far_each_landmark_lies(template, scan):
    marks = dict(scan.landmarks)
    at = scan.vertices[marks["chin"]] + [14, 0, 0]
    marks["chin"] = int(np.linalg.norm(scan.vertices - at, axis=1).argmin())
    moved = fit_scan(template, TriangleMesh(scan.vertices, scan.faces, marks)).report
    clean = fit_scan(template, scan).report
    assert set(moved.landmarks) == set(scan.landmarks)
    assert max(moved.landmarks, key=moved.landmarks.get) == "chin"
    assert moved.landmarks["chin"] > clean.landmarks["chin"] + 6
    assert "chin" in repr(moved)


def test_good_fits_have_no_fold(template, scan, glued):
    for fit in (fit_scan(template, scan), fit_markers(template, *glued)):
        r = fit.report
        assert r.turned == 0 and r.crossings == 0 and r.folds < 10
        assert r.drawn > 0.85


def test_folds_and_crossings_are_counted(template):
    assert not crossings(template)
    V = template.vertices.copy()
    v = template.landmarks["nose_tip"]
    V[v] += [0, 25, -12]  # over its neighbours, through the bridge of the nose
    pushed = template.with_vertices(V)
    assert len(folds(pushed) - folds(template)) >= 3
    cut = crossings(pushed)
    star = set(np.flatnonzero((template.faces == v).any(axis=1)).tolist())
    assert all(star & {i, j} for i, j in cut)


def test_crossings_are_those_of_a_plain_search(rng):
    V = rng.normal(size=(60, 3))
    F = np.array([rng.choice(60, 3, replace=False) for _ in range(40)])

    def meets(i, j):
        tests = []
        for one, two in ((i, j), (j, i)):
            a, b, c = V[F[two]]
            for s, e in pairwise([*F[one], F[one][0]]):
                if {s, e} & set(F[two]):
                    continue
                # V[s] + t (V[e] - V[s]) = a + x (b - a) + y (c - a)
                A = np.stack([V[e] - V[s], a - b, a - c], axis=1)
                t, x, y = np.linalg.solve(A, a - V[s])
                tests.append(0 < t < 1 and x > 0 and y > 0 and x + y < 1)
        return any(tests)

    slow = {
        (i, j)
        for i in range(40)
        for j in range(i + 1, 40)
        if len(set(F[i]) & set(F[j])) < 2 and meets(i, j)
    }
    assert crossings(TriangleMesh(V, F)) == slow and slow
