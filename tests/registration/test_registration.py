from dataclasses import replace

import numpy as np
import pytest
from shapes import grid_mesh
from threadpoolctl import threadpool_limits

import facelab
from data_synth.actors import ACTORS
from data_synth.template import build_template
from facelab.geometry.alignment import procrustes
from facelab.geometry.closest import closest_points
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.motion import MarkerSequence
from facelab.registration import fit_markers, fit_scan, rest_markers
from facelab.registration.confidence import expected_error, free_edges
from facelab.registration.layout import MarkerLayout, covariance, kernel
from facelab.registration.sequence import Fault, register_sequence

N = 3000  # vertices of the small captures, so that template and truth correspond one to one


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def template():
    face = build_template(n_vertices=N)
    names = dict(zip(MULTI_PIE, face.landmarks.tolist(), strict=True))
    return TriangleMesh(face.vertices, face.faces, names)


@pytest.fixture(scope="module")
def captures():
    return {
        actor: facelab.data.load_capture(actor, size="small", progress=False) for actor in ACTORS
    }


@pytest.fixture(scope="module")
def at_rest(captures):
    """Names and places of the real markers of each actor at rest."""
    found = {}
    for actor, capture in captures.items():
        found[actor] = rest_markers([capture.markers(take) for take in capture.texts])
    return found


@pytest.fixture(scope="module")
def fits(template, at_rest):
    return {actor: fit_markers(template, *at_rest[actor]) for actor in ACTORS}


@pytest.fixture
def fit(fits):
    return fits["M1"]


@pytest.fixture
def take(captures):
    return captures["M1"].markers("rage_1")


def rms(values):
    return float(np.sqrt((values**2).mean()))


def with_positions(markers, positions):
    return MarkerSequence(positions, markers.names, markers.fps)


def correspondence(vertices, truth):
    return np.linalg.norm(procrustes(vertices, truth).apply(vertices) - truth, axis=1)


def motion_error(fit, capture, name, registration):
    """Distance of the dense motion from the true one, (n_frames, n_vertices), mm."""
    neutral = capture.neutral.vertices
    turn = procrustes(fit.mesh.vertices, neutral).rotation
    moved = (registration.positions() - fit.mesh.vertices) @ turn.T
    return np.linalg.norm(moved - (capture.surface(name) - neutral), axis=2)


def covered(fit):
    """Skin within 11 mm of a marker, which is how far apart they are glued."""
    feet = np.unique(fit.mesh.faces[fit.faces][:, 0])
    return fit.mesh.geodesics(feet).min(axis=0) < 11


# --- neutrals -------------------------------------------------------------------------------------


@pytest.mark.parametrize("actor", ACTORS)
def test_a_neutral_fits_its_markers_and_corresponds_where_none_were(actor, fits, captures):
    fit = fits[actor]
    noise = np.linalg.norm(captures[actor].truth(captures[actor].takes["train"][0]).noise)
    assert fit.rms < noise + 0.3  # the aim of the method, mm
    off = correspondence(fit.mesh.vertices, captures[actor].neutral.vertices)
    unused = off[[v for name, v in fit.mesh.landmarks.items() if name not in fit.landmarks]]
    assert unused.mean() < 1.5 and np.quantile(unused, 0.95) < 3
    assert rms(off) < 2


def test_every_step_brings_the_actors_nearer_to_the_truth(fits, captures):
    def mean_error(step):
        return np.mean(
            [rms(correspondence(f.steps[step], captures[a].neutral.vertices))
             for a, f in fits.items()]
        )  # fmt: skip

    last = list(next(iter(fits.values())).steps)[-1]
    errors = [mean_error(step) for step in ("similarity", "warp", "stage 1", last)]
    assert errors == sorted(errors, reverse=True)


def test_no_triangle_is_turned_over_by_the_fit(fits, template):
    for fit in fits.values():
        turned = procrustes(fit.mesh.vertices, template.vertices).apply(fit.mesh.vertices)
        agree = (template.with_vertices(turned).normals * template.normals).sum(axis=1)
        assert (agree > 0).mean() > 0.995


def test_a_face_that_moves_as_a_whole_is_fitted_alike(template, at_rest, fits):
    positions, names = at_rest["F1"]
    turn = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    again = fit_markers(template, positions @ turn.T + [1000, -50, 3], names)
    np.testing.assert_allclose(again.mesh.vertices, fits["F1"].mesh.vertices, atol=1e-6)


def test_markers_glued_to_the_template_itself_leave_it_as_it_is(template, captures):
    sites = captures["M1"].sites
    feet, normals = sites.feet_and_normals(template.vertices[template.faces[sites.faces]][None])
    fit = fit_markers(template, (feet + 1.5 * normals)[0], sites.names)
    off = np.linalg.norm(fit.mesh.vertices - template.vertices, axis=1)
    assert rms(off) < 0.8  # landmarks are glued up to 0.9 mm beside their vertex


def test_presets_trade_fit_against_smoothness(template, at_rest):
    left = [
        fit_markers(template, *at_rest["F2"], preset=p).rms for p in ("smooth", "balanced", "close")
    ]
    assert left == sorted(left, reverse=True)


def test_the_face_at_rest_is_told_from_the_starts_of_takes(captures, at_rest):
    capture = captures["M1"]
    corners = capture.neutral.vertices[capture.neutral.faces[capture.sites.faces]][None]
    feet, normals = capture.sites.feet_and_normals(corners)
    truth = dict(zip(capture.sites.names, (feet + 1.5 * normals)[0], strict=True))
    positions, names = at_rest["M1"]
    assert procrustes(positions, np.array([truth[n] for n in names])).rms < 0.2


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda P, names: (P * [-1, 1, 1], names), "mirrored"),
        (lambda P, names: (P / 1000, names), "metres: multiply by 1000"),
        (lambda P, names: (P, [f"x{i}" for i in range(len(P))]), "share 0 name"),
        (lambda P, names: (P[:5], names[:5]), "share 5 name"),
        (lambda P, names: (P[:-1], names), "positions has shape"),
        (lambda P, names: (P, [names[1], *names[1:]]), "more than once"),
        (lambda P, names: (np.outer(np.arange(len(P)), [1, 2, 3]), names), "one line"),
    ],
)  # fmt: skip
def test_markers_that_cannot_be_a_face_are_refused(template, at_rest, spoil, message):
    with pytest.raises(ValueError, match=message):
        fit_markers(template, *spoil(*at_rest["M1"]))


def test_a_misnamed_landmark_is_named(template, at_rest):
    positions, names = at_rest["M1"]
    i, j = names.index("chin"), names.index("brow_left_1")
    names = list(names)
    names[i], names[j] = names[j], names[i]
    with pytest.raises(ValueError, match=r"(chin|brow_left_1) \(\d+ mm\)"):
        fit_markers(template, positions, names)


@pytest.mark.parametrize(
    "wrong", [{"preset": "best"}, {"offset": -1}]
)  # fmt: skip
def test_wrong_options_are_refused(template, at_rest, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        fit_markers(template, *at_rest["M1"], **wrong)


# --- scans ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scan(captures):
    """An actor's neutral with other triangles, a hole, half of the forehead and its place lost."""
    face = build_template(captures["F1"].rig.template.anatomy, 4375)
    names = dict(zip(MULTI_PIE, face.landmarks.tolist(), strict=True))
    V = face.vertices
    hole = np.linalg.norm(V - V[names["jaw_left_4"]] - [-25, 10, 10], axis=1) < 12
    keep = ~hole & (V[:, 1] < np.quantile(V[:, 1], 0.9))
    return TriangleMesh(V, face.faces, names).submesh(keep)


def test_a_scan_is_met_within_a_fraction_of_a_millimetre(template, scan, captures):
    held = [n for n in scan.landmarks if n.startswith(("eye", "lip"))][::3]
    fit = fit_scan(template, scan, [n for n in scan.landmarks if n not in held])
    assert fit.residuals.mean() < 0.3  # facets of 2 mm on either side
    off = correspondence(fit.mesh.vertices, captures["F1"].neutral.vertices)
    assert np.mean([off[fit.mesh.landmarks[n]] for n in held]) < 2
    assert rms(off) < 3 and len(fit.residuals) < 0.97 * N  # and what is lost is not matched


def test_vertices_are_not_drawn_to_the_border_of_a_scan(template):
    half = template.submesh(template.vertices[:, 0] < 25)
    fit = fit_scan(template, half)
    off = np.linalg.norm(
        fit.alignment.inverse().apply(fit.mesh.vertices) - template.vertices, axis=1
    )
    assert off.max() < 0.5  # matched to the border, the missing half would shrink by centimetres


def test_vertices_are_not_drawn_to_what_stands_across_the_skin(template):
    V, marks = template.vertices, template.landmarks
    brow, top = max(V[v, 1] for name, v in marks.items() if "brow" in name), V[:, 1].max()
    gone = (np.abs(V[:, 0]) < 8) & (V[:, 1] > brow + 8) & (V[:, 1] < top - 8)
    skin, low, high = template.submesh(~gone), V[gone].min(axis=0), V[gone].max(axis=0)
    wall = grid_mesh(16, 16, 1.0)  # in the gap on the forehead, 60 mm and more through the skin
    along, through = wall.vertices[:, 0] / 15, wall.vertices[:, 1] / 15
    y = np.interp(along, [0, 1], [low[1] + 2, high[1] - 2])
    z = np.interp(through, [0, 1], [low[2] - 30, high[2] + 30])
    places = np.vstack([skin.vertices, np.stack([0 * y, y, z], axis=1)])
    scan = TriangleMesh(
        places, np.vstack([skin.faces, wall.faces + skin.n_vertices]), skin.landmarks
    )
    fit = fit_scan(template, scan)
    assert not fit.drawn[gone].any()
    off = fit.alignment.inverse().apply(fit.mesh.vertices) - V
    assert np.abs(off).max() < 1e-6  # drawn to the wall, they would go sideways by 3 mm


def test_a_scan_in_metres_is_refused(template):
    small = template.with_vertices(template.vertices / 1000)
    with pytest.raises(ValueError, match="metres"):
        fit_scan(template, small)
    with pytest.raises(ValueError, match="landmarks names nose"):
        fit_scan(template, template, ["nose"])


@pytest.mark.real
def test_scanned_identities_are_met_within_a_millimetre(template, ict_root, ict_cache, monkeypatch):
    monkeypatch.setenv("FACELAB_CACHE", str(ict_cache))
    scan = facelab.load_ict_facekit(ict_root, "narrow").neutral
    fit = fit_scan(template, scan)
    placed = scan.with_vertices(fit.alignment.apply(scan.vertices))
    faces, weights = closest_points(placed, fit.mesh.vertices)
    place = np.einsum("nc,ncx->nx", weights, placed.vertices[placed.faces[faces]])
    assert np.linalg.norm(place - fit.mesh.vertices, axis=1)[fit.mesh.landmarks["chin"]] < 1
    assert fit.residuals.mean() < 1 and len(fit.residuals) > 0.8 * N


# --- sequences ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("actor", "name"), [("M1", "rage_1"), ("M1", "rom"), ("F2", "pride_5")])
def test_dense_motion_is_within_a_millimetre_of_the_truth(actor, name, fits, captures):
    fit, capture = fits[actor], captures[actor]
    registration = register_sequence(fit, capture.markers(name))
    error = motion_error(fit, capture, name, registration)
    assert rms(error[:, covered(fit)]) < 1
    assert registration.rms < np.linalg.norm(capture.truth(name).noise) + 0.3


def test_with_a_fifth_of_the_markers_missing_the_error_grows_by_less_than_half(
    fit, captures, take, rng
):
    hidden = ~take.visible
    while hidden.mean() < 0.2:
        frame, marker = rng.integers(take.n_frames), rng.integers(take.n_markers)
        hidden[frame : frame + 7, marker] = True
    gappy = with_positions(take, np.where(hidden[..., None], np.nan, take.positions))
    skin = covered(fit)
    full, less = (
        rms(motion_error(fit, captures["M1"], "rage_1", register_sequence(fit, m))[:, skin])
        for m in (take, gappy)
    )
    assert full < less < 1.5 * full


@pytest.mark.parametrize("actor", ["M1", "F2"])
def test_the_head_is_told_from_the_face(actor, fits, captures):
    fit, capture = fits[actor], captures[actor]
    face, sites = capture.neutral, capture.sites
    feet, normals = sites.feet_and_normals(face.vertices[face.faces[sites.faces]][None])
    at = [sites.names.index(name) for name in fit.names]
    link = procrustes((feet + 1.5 * normals)[0, at], fit.rest)
    truth = capture.truth("pride_1")
    angles = {}
    for way in ("rigid", "whole"):
        head = register_sequence(fit, capture.markers("pride_1"), head=way).head
        turn = head.rotation @ link.rotation @ np.swapaxes(truth.rotation, 1, 2)
        angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
        angles[way] = np.degrees(rms(angle))
        if way == "rigid":  # the aims: 0.3 degrees, 0.3 mm
            place = head.rotation @ link.translation + head.translation - truth.translation
            assert np.sqrt((place**2).sum(axis=1).mean()) < 0.3
    assert angles["rigid"] < 0.3 < angles["whole"]  # on the whole face it moves with the expression


def test_hidden_markers_give_what_a_refit_with_the_seen_ones_would(fit, take, rng):
    moved = take.select(fit.names).positions.astype(float)
    moved = rng.normal(scale=4, size=moved.shape)[:6]
    hidden = rng.random(moved.shape[:2]) < np.array([0, 0.05, 0.2, 0.5, 0.9, 0.2])[:, None]
    moved[hidden] = np.nan
    dense = fit.layout.carry @ fit.layout.filled(moved)
    for frame, gone in enumerate(hidden):
        seen = ~gone
        fewer = replace(
            fit, names=tuple(np.array(fit.names)[seen]), rest=fit.rest[seen],
            faces=fit.faces[seen], weights=fit.weights[seen],
        )  # fmt: skip
        refit = MarkerLayout(fewer).carry @ moved[frame, seen]
        np.testing.assert_allclose(dense[frame], refit, atol=1e-8)


def test_left_out_markers_are_judged_as_by_a_refit_without_them(fit, rng):
    moved = rng.normal(size=(1, len(fit.names), 3))
    off = fit.layout.left_out(moved)
    without = moved.copy()
    without[0, 7] = np.nan
    np.testing.assert_allclose(off[0, 7], moved[0, 7] - fit.layout.filled(without)[0, 7], atol=1e-8)


def test_a_face_at_rest_stays_at_rest_and_a_shift_is_carried_whole(fit):
    still = np.zeros((1, len(fit.names), 3))
    assert np.abs(fit.layout.carry @ fit.layout.filled(still)).max() == 0
    shift = fit.layout.carry @ np.ones(len(fit.names))
    assert np.abs(shift[covered(fit)] - 1).max() < 0.01


def test_swaps_are_found_put_back_and_reported(fit, take):
    clean = register_sequence(fit, take)
    positions = take.positions.copy()
    near = np.linalg.norm(fit.rest - fit.rest[fit.names.index("lip_upper")], axis=1).argsort()
    pairs = [("lip_upper", fit.names[near[1]]), ("brow_left_5", "nose_bridge_1")]
    planted = []
    for after, pair in zip((10, 90), pairs, strict=True):
        both = [take.names.index(name) for name in pair]
        shown = take.visible[:, both].all(axis=1)  # else the exchange is one marker gone astray
        first = next(f for f in range(after, 180) if shown[f : f + 9].all())
        positions[first : first + 9, both] = positions[first : first + 9, both[::-1]]
        planted.append((first, first + 9, set(pair)))
    registration = register_sequence(fit, with_positions(take, positions))
    found = [f for f in registration.faults if f.kind == "swap"]
    assert [(f.first, f.stop, set(f.names)) for f in found] == planted
    assert np.abs(registration.displacements - clean.displacements).max() < 0.5


def test_the_faults_of_the_captures_are_all_found_and_none_made_up(fits, captures):
    for actor in ("M1", "F2"):
        capture = captures[actor]
        for name in capture.texts:
            truth = capture.truth(name)
            faults = register_sequence(fits[actor], capture.markers(name)).faults
            swaps = {(f.first, f.stop, frozenset(f.names)) for f in faults if f.kind == "swap"}
            assert swaps == {(s.first, s.stop, frozenset((s.a, s.b))) for s in truth.swaps}
            ghosts = [f for f in faults if f.kind == "ghost"]
            assert sum(f.stop - f.first for f in ghosts) == sum(
                g.stop - g.first for g in truth.ghosts
            )
            assert not [f for f in faults if f.kind == "stray"]


def test_a_ghost_under_the_name_of_a_marker_is_a_stray_and_not_believed(fit, take):
    clean = register_sequence(fit, take, bridge=0)
    positions = take.positions.copy()
    positions[50:58, take.names.index("nose_tip")] += [12, 0, 10]
    registration = register_sequence(fit, with_positions(take, positions), bridge=0)
    assert Fault("stray", 50, 58, ("nose_tip",)) in registration.faults
    assert not registration.seen[50:58, fit.names.index("nose_tip")].any()
    change = np.abs(registration.positions([54]) - clean.positions([54]))
    assert change.max() < 2


def test_bridged_gaps_are_nearer_to_the_truth_and_long_ones_are_reported(fit, take):
    whole = register_sequence(fit, take, bridge=0)
    marker = fit.names.index("mouth_corner_left")
    column = take.names.index("mouth_corner_left")
    seen = take.visible[:, column]
    starts = [f for f in range(10, 170, 12) if seen[f - 1 : f + 6].all()]
    positions = take.positions.copy()
    gaps = np.concatenate([np.arange(f, f + 5) for f in starts])
    positions[gaps, column] = np.nan
    off = {}
    for bridge in (0, 0.1):
        found = register_sequence(fit, with_positions(take, positions), bridge=bridge)
        off[bridge] = rms(found.displacements[gaps, marker] - whole.displacements[gaps, marker])
        long = {(f.first, f.stop) for f in found.faults if f.kind == "gap"
                and f.names == ("mouth_corner_left",)}  # fmt: skip
        assert ({(f, f + 5) for f in starts} <= long) == (bridge == 0)
    assert off[0.1] < 0.7 * off[0]


def test_lost_frames_keep_their_place(fit, take):
    positions = take.positions.copy()
    positions[5] = np.nan
    positions[9, 2:] = np.nan
    registration = register_sequence(fit, with_positions(take, positions))
    assert np.flatnonzero(~registration.valid).tolist() == [5, 9]
    assert np.isnan(registration.positions([5])).all()
    assert np.isnan(registration.rms_per_frame[[5, 9]]).all()
    motion = registration.motion()
    assert motion.n_frames == take.n_frames and not motion.valid[5]


def test_dense_frames_come_in_parts_and_on_the_397(fit, take):
    registration = register_sequence(fit, take)
    everything = registration.positions()
    np.testing.assert_allclose(registration.positions(block=7), everything, atol=1e-4)  # float32
    samples, small = fit.mesh.subsample(397)
    motion = registration.motion(samples, small)
    np.testing.assert_allclose(motion.positions, everything[:, samples], atol=1e-4)
    np.testing.assert_array_equal(motion.mesh.faces, small.faces)
    with pytest.raises(ValueError, match="together"):
        registration.motion(samples)


def test_the_report_tells_where_the_motion_is_uncertain(fit, take, captures):
    registration = register_sequence(fit, take)
    error = np.sqrt((motion_error(fit, captures["M1"], "rage_1", registration) ** 2).mean(axis=0))
    skin = covered(fit)
    assert 0.5 < rms(registration.confidence[skin]) / rms(error[skin]) < 2
    assert np.corrcoef(registration.confidence, error)[0, 1] > 0.3
    assert registration.rms_per_marker.shape == (len(fit.names),)
    assert registration.rms_per_frame.shape == (take.n_frames,)
    assert f"{registration.rms:.2f} mm" in repr(registration)


def test_motion_drawn_from_the_field_itself_has_the_error_that_is_expected(fit, rng):
    layout, mesh, preset = fit.layout, fit.mesh, fit.preset
    lids, lips = free_edges(mesh)
    calm = mesh.geodesics(np.append(lids, lips)).min(axis=0) > 30  # where nothing moves alone
    some = np.flatnonzero(calm)[::12]
    at = np.append(layout.feet, some)
    field = preset.motion_size**2 * covariance(kernel(mesh, at, preset.motion_reach)[at])
    values, vectors = np.linalg.eigh(field)
    drawn = rng.normal(size=(1000, 3, len(at))) @ (vectors * np.sqrt(values.clip(0))).T
    drawn = np.swapaxes(drawn, 1, 2)
    true, seen = drawn[:, len(layout.feet) :], drawn[:, : len(layout.feet)]
    seen = seen + rng.normal(scale=preset.noise, size=seen.shape)
    left_out = np.sqrt((layout.left_out(seen) ** 2).sum(axis=2).mean(axis=0))
    error = np.linalg.norm(layout.carry[some] @ seen - true, axis=2)
    error = np.sqrt((error**2).mean(axis=0))  # in three axes, as all errors here
    expected = expected_error(fit, left_out)[some]
    np.testing.assert_allclose(expected / error, 1.2, rtol=0.15)  # its margin; 1,000 frames
    assert np.median(expected / error) == pytest.approx(1.2, rel=0.03)


def test_a_marker_that_the_take_lacks_is_listed_and_led_by_the_others(fit, take):
    fewer = take.select([n for n in take.names if n != "chin"])
    registration = register_sequence(fit, fewer)
    assert registration.missing == ("chin",)
    assert np.isnan(registration.rms_per_marker[fit.names.index("chin")])
    assert np.isfinite(registration.confidence).all()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda m: m.select(m.names[:2]), "2 of the"),
        (lambda m: with_positions(m, m.positions * [-1, 1, 1]), "mirrored"),
        (lambda m: with_positions(m, m.positions / 1000), "millimetres"),
        (lambda m: with_positions(m, np.full_like(m.positions, np.nan)), "none of the"),
        (lambda m: MarkerSequence(m.positions, m.names[::-1], m.fps), "another layout"),
    ],
)  # fmt: skip
def test_takes_that_do_not_fit_the_layout_are_refused(fit, take, spoil, message):
    with pytest.raises(ValueError, match=message):
        register_sequence(fit, spoil(take))


@pytest.mark.parametrize("wrong", [{"head": "neck"}, {"bridge": -1}, {"limit": 0}])
def test_wrong_options_of_a_sequence_are_refused(fit, take, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        register_sequence(fit, take, **wrong)


def test_takes_without_a_start_are_refused(take):
    with pytest.raises(ValueError, match="takes is empty"):
        rest_markers([])
    with pytest.raises(ValueError, match=r"takes hold 0 marker\(s\)"):
        rest_markers(with_positions(take, np.full_like(take.positions, np.nan)))
    late = take.positions.copy()
    late[:20] = np.nan
    with pytest.raises(ValueError, match="hold no frame"):
        rest_markers(with_positions(take, late))
