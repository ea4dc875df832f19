"""Takes and templates as people have them: right, said, or refused."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import facelab
from data_synth.template import build_template
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.motion import MarkerSequence
from facelab.registration import fit_markers, fit_scan, register_sequence, rest_markers

FPS = 60


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def face():
    face = build_template(n_vertices=1500)
    return TriangleMesh(
        face.vertices, face.faces, dict(zip(MULTI_PIE, face.landmarks.tolist(), strict=True))
    )


def moved(face, n_frames=90, scale=(1, 1, 1)):
    """Markers at the landmarks of a face that opens and shuts its mouth, with a little noise."""
    V = (face.vertices * scale)[list(face.landmarks.values())]
    near = np.exp(-((np.linalg.norm(V - V[8], axis=1) / 40) ** 2))
    open_ = np.sin(np.linspace(0, 3 * np.pi, n_frames)) ** 2
    down = open_[:, None, None] * near[:, None] * np.array([0, -10.0, -3.0])
    noise = np.random.default_rng(4).normal(scale=0.1, size=(n_frames, len(V), 3))
    return MarkerSequence(V + down + noise + [300, 1200, 0], tuple(face.landmarks), FPS)


@pytest.fixture(scope="module")
def take(face):
    return moved(face)


@pytest.fixture(scope="module")
def fit(face, take):
    return fit_markers(face, *rest_markers(take), offset=0)


def spoiled(take, positions):
    return MarkerSequence(positions, take.names, take.fps)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda P: P / 1000, r"takes\[1\].*metres: multiply by 1000"),
        (lambda P: P / 10, r"takes\[1\].*centimetres: multiply by 10"),
        (lambda P: P * [-1, 1, 1], r"takes\[1\] is mirrored beside takes\[0\]"),
        (lambda P: P[:, ::-1], r"takes\[1\] begins with its markers .* another layout"),
    ],
)
def test_a_rest_out_of_takes_that_are_not_of_one_face_is_refused(take, spoil, message):
    with pytest.raises(ValueError, match=message):
        rest_markers([take, spoiled(take, spoil(take.positions))])


def test_a_take_that_begins_with_another_face_is_said(face, take, recwarn):
    rest_markers([take, take[::-1]])
    assert not recwarn
    with pytest.warns(UserWarning, match=r"takes\[1\] begins with another face than takes\[0\]"):
        rest_markers([take, moved(face, scale=(1.15, 1, 1.1))])


def test_markers_that_are_never_seen_at_rest_are_named(take):
    names = take.names
    with pytest.warns(UserWarning, match=r"30 of 68 markers are not seen.*jaw_right_1"):
        positions, _ = rest_markers([take.select(names[:30]), take.select(names[30:])])
    assert np.isnan(positions[:30]).all() and np.isfinite(positions[30:]).all()


def test_a_rest_in_metres_is_called_that(take):
    with pytest.raises(ValueError, match="a face's 70 to 700: multiply positions by 1000"):
        rest_markers(spoiled(take, take.positions / 1000))


@pytest.mark.parametrize("given", ["take.c3d", ["take.c3d"], np.zeros((3, 3)), 5, [None]])
def test_what_is_no_take_has_no_rest(given):
    with pytest.raises(TypeError, match=r"takes\[0\] is a .* must be of type MarkerSequence"):
        rest_markers(given)


def test_takes_without_frames_have_no_rest(take):
    with pytest.raises(ValueError, match="takes is empty"):
        rest_markers([take[:0]])


def test_a_take_of_another_face_is_said(face, fit, take, recwarn):
    register_sequence(fit, take, progress=False)
    assert not recwarn
    with pytest.warns(UserWarning, match="never come within 2.5 mm of their places at rest"):
        register_sequence(fit, moved(face, scale=(1.15, 1, 1.1)), progress=False)


def test_a_marker_that_falls_to_the_floor_takes_no_skin_along(fit, take):
    clean = register_sequence(fit, take, progress=False)
    P, brow = take.positions.copy(), take.names.index("brow_left_3")
    time = np.arange(45) / FPS
    P[45:, brow] = P[45, brow] + np.outer(time**2, [0, -9810 / 2, 0])  # smoothly: it never jumps
    fell = register_sequence(fit, spoiled(take, P), progress=False)
    stray = [f for f in fell.faults if f.kind == "stray"]
    assert [f.names for f in stray] == [("brow_left_3",)] and stray[0].stop == 90
    apart = np.linalg.norm(fell.positions() - clean.positions(), axis=2)
    assert apart.max() < fell.fit.rest.std()  # it was 400 mm
    assert apart[: stray[0].first - 10].max() < 0.5


def test_what_a_take_lacks_is_in_its_report(fit, take):
    found = register_sequence(fit, take.select(take.names[:20]), progress=False)
    assert "not in the take, led by the others: 48 of 68 markers" in found.report
    assert "led by the others" not in register_sequence(fit, take, progress=False).report


def test_registration_takes_fits_of_markers_and_takes_of_markers_alone(face, fit, take):
    scan = fit_scan(face, face.with_vertices(face.vertices * 1.01))
    with pytest.raises(TypeError, match="fit is a Fit, but must be of type MarkerFit"):
        register_sequence(scan, take)
    with pytest.raises(TypeError, match=r"markers is a ndarray.*read_markers"):
        register_sequence(fit, take.positions)


def test_dense_frames_are_picked_by_what_there_is(fit, take):
    found = register_sequence(fit, take, progress=False)
    mask = np.arange(take.n_frames) % 30 == 0
    np.testing.assert_array_equal(found.positions(mask), found.positions([0, 30, 60]))
    for frames in ([-1], [90]):
        with pytest.raises(ValueError, match=r"frames holds .* there are 90 frames: 0 to 89"):
            found.positions(frames)
    with pytest.raises(ValueError, match="vertices holds 1500, but there are 1500 vertices"):
        found.positions(vertices=[1500])
    for wrong in ([1.0], mask[:-1]):
        with pytest.raises(TypeError, match="frames has shape"):
            found.positions(wrong)
    for block in (0, -1):  # -1 gave memory that nothing was written to
        with pytest.raises(ValueError, match=f"block={block}"):
            found.positions(block=block)


@pytest.mark.parametrize("kind", ["markers", "scan"])
def test_a_template_that_cannot_be_fitted_is_refused(face, take, kind):
    rest, names = rest_markers(take)

    def fit_to(template):
        return fit_markers(template, rest, names) if kind == "markers" else fit_scan(template, face)

    with pytest.raises(ValueError, match=r"template: all its triangles .* are wound inwards"):
        fit_to(TriangleMesh(face.vertices, face.faces[:, ::-1], face.landmarks))
    left = face.vertices[face.faces].mean(axis=1)[:, :1] > 0
    half = np.where(left, face.faces[:, ::-1], face.faces)
    with pytest.raises(ValueError, match=r"template: 14\d\d of its triangles .*geometry\.outwards"):
        fit_to(TriangleMesh(face.vertices, half, face.landmarks))
    low = face.vertices[:, 1] < face.vertices[face.landmarks["nose_tip"], 1]
    with pytest.raises(ValueError, match=r"template: its landmarks .* are vertices of no triangle"):
        fit_to(TriangleMesh(face.vertices, face.faces[low[face.faces].all(axis=1)], face.landmarks))


def test_a_template_that_opens_along_a_seam_is_said(face, take, recwarn):
    rest, names = rest_markers(take)
    left = face.vertices[face.faces].mean(axis=1)[:, 0] > 0
    seam = np.intersect1d(face.faces[left], face.faces[~left])
    new = np.arange(face.n_vertices)
    new[seam] = face.n_vertices + np.arange(len(seam))
    faces = np.where(left[:, None], new[face.faces], face.faces)
    cut = TriangleMesh(np.vstack([face.vertices, face.vertices[seam]]), faces, face.landmarks)
    with pytest.warns(UserWarning, match="lie on each other, as along the seams of a texture"):
        found = register_sequence(fit_markers(cut, rest, names, offset=0), take, progress=False)
    dense = found.positions()
    assert np.linalg.norm(dense[:, seam] - dense[:, face.n_vertices :], axis=2).max() > 0.2
    recwarn.clear()
    fit_markers(cut.welded()[0], rest, names, offset=0)
    assert not recwarn


@pytest.mark.parametrize(
    ("positions", "error", "message"),
    [
        (
            lambda P: np.ma.masked_array(P, mask=P > 1e4 * (P == P.max())),
            ValueError,
            "masked array",
        ),
        (lambda P: P + 1j, TypeError, "makes no array of numbers"),
        (lambda P: P.astype(str), TypeError, "makes no array of numbers"),
    ],
)
def test_places_that_are_no_numbers_or_hidden_are_refused(face, take, positions, error, message):
    rest, names = rest_markers(take)
    hidden = np.ma.masked_array(rest, mask=np.zeros(rest.shape, bool))
    hidden[3] = np.ma.masked
    given = hidden if error is ValueError else positions(rest)
    with pytest.raises(error, match=message):
        fit_markers(face, given, names)
    with pytest.raises(error, match=message):
        MarkerSequence(given[None], names, FPS)
    with pytest.raises(error, match=message):
        replace(facelab.MotionSequence(face.vertices[None], FPS, face), positions=given[None])


def test_names_are_texts(face, take):
    with pytest.raises(TypeError, match=r"names holds 0, 1.*map"):
        MarkerSequence(take.positions, range(68), FPS)
    with pytest.raises(TypeError, match="names=None"):
        fit_markers(face, take.positions[0], None)


def test_a_motion_has_a_mesh(face):
    with pytest.raises(TypeError, match="mesh is a ndarray, but must be of type TriangleMesh"):
        facelab.MotionSequence(face.vertices[None], FPS, face.vertices)


def test_a_mouth_wide_open_loses_no_frame_where_nine_markers_are_glued(face):
    """Five of them go with the mouth, so that most distances between markers change."""
    names = "chin lip_lower lip_upper mouth_corner_left mouth_corner_right nose_tip nose_bridge_1 "
    names = [*names.split(), "eye_left_outer", "eye_right_outer"]
    rest = face.vertices[[face.landmarks[n] for n in names]]
    share = np.array([1, 0.9, 0.1, 0.5, 0.5, 0, 0, 0, 0])
    opens = np.sin(np.linspace(0, 12, 300)).clip(0) ** 4
    positions = rest + opens[:, None, None] * share[:, None] * np.array([0, -35.0, -12.0])
    take = MarkerSequence(positions, names, 60)
    found = register_sequence(fit_markers(face, rest, names, offset=0), take, progress=False)
    assert found.valid.all() and found.seen.all()
