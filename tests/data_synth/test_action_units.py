"""The action units of the synthetic faces: human range, mirror, lids, lips, jaw, and the scan."""

import shutil

import numpy as np
import pytest
from crossings import angles, self_intersections

from data_synth.action_units import ActionUnitRig, actor_rig
from data_synth.actors import ACTORS, Style
from data_synth.articulation import JAW
from data_synth.compare_scan import compare
from data_synth.template import build_template
from data_synth.units import UNIT_TABLE, UNITS
from facelab.rig import BlendshapeRig

FLIP = np.array([-1.0, 1.0, 1.0])
PRESSING = (
    ("AU17", "AU24", "AU10"), ("AU17", "AU24"), ("AU28", "AU17"), ("AU12", "AU17"),
    ("AU12L", "AU15", "AU17"), ("AU18", "AU24"), ("AU23", "AU15", "AU17", "AU20L"),
    ("AU30L", "AU12R", "AU17"), ("AU29", "AU24"),
)  # fmt: skip
CLOSED = ("AU4", "AU6", "AU12", "AU13", "AU14", "AU15", "AU17", "AU18", "AU20", "AU23", "AU24",
          "AU28", "AU29", "AU34", "AU35", "AU38", "AU45")  # fmt: skip


@pytest.fixture(scope="module")
def rig():
    return ActionUnitRig(build_template())


@pytest.fixture(scope="module")
def weights(rig):
    """Two hundred sparse combinations, among them those that press the lips together."""
    rng = np.random.default_rng(3)
    W = rng.uniform(size=(200, 40)) * (rng.uniform(size=(200, 40)) < 0.15)
    for row, names in enumerate(PRESSING):
        W[row] = rig.weights_of(dict.fromkeys(names, 1.0))
    return W


@pytest.fixture(scope="module")
def shapes(rig, weights):
    return rig.animate(weights)


def at(rig, unit, landmark):
    """Displacement of a landmark at the peak of a unit, mm."""
    return rig.deltas[UNITS.index(unit), rig.neutral.landmarks[landmark]]


def test_there_are_the_forty_units_in_their_order(rig):
    assert rig.names == UNITS
    assert rig.deltas.shape == (40, 8820, 3)
    assert rig.deltas.dtype == np.float64
    assert (np.linalg.norm(rig.deltas, axis=2).max(1) > 1.0).all()


def test_right_units_mirror_left_units(rig):
    mirror = rig.template.mirror
    for k, name in enumerate(UNITS):
        twin = name[:-1] + {"L": "R", "R": "L"}[name[-1]] if name[-1] in "LR" else name
        np.testing.assert_allclose(
            rig.deltas[UNITS.index(twin)], (rig.deltas[k] * FLIP)[mirror], atol=1e-9, err_msg=name
        )


@pytest.mark.parametrize(
    "unit, landmark, direction, low, high",
    [
        ("AU1", "brow_left_5", (0, 1, 0), 4, 8),
        ("AU2L", "brow_left_2", (0, 1, 0), 5, 9),
        ("AU4", "brow_left_4", (-0.5, -0.8, 0), 3, 8),
        ("AU10L", "lip_upper_left_outer", (0, 1, 0), 3, 8),
        ("AU12L", "mouth_corner_left", (0.5, 0.85, 0), 9, 14),
        ("AU15", "mouth_corner_left", (0, -1, 0), 4, 8),
        ("AU18", "mouth_corner_left", (-1, 0, 0), 6, 11),
        ("AU18", "lip_upper", (0, 0, 1), 4, 9),
        ("AU20L", "mouth_corner_left", (0.7, 0, -0.7), 6, 11),
        ("AU26", "chin", (0, -0.7, -0.7), 10, 17),
        ("AU27", "chin", (0, -0.7, -0.7), 26, 40),
        ("AU29", "chin", (0, 0, 1), 4, 8),
        ("AU30L", "chin", (1, 0, 0), 5, 11),
        ("AU45L", "eye_left_upper_inner", (0, -1, 0), 5, 10),
        ("AU5", "eye_left_upper_inner", (0, 1, 0), 1, 3.5),
    ],
)
def test_peaks_are_within_human_range(rig, unit, landmark, direction, low, high):
    direction = np.array(direction) / np.linalg.norm(direction)
    assert low < at(rig, unit, landmark) @ direction < high


@pytest.mark.parametrize("actor", [None, *ACTORS])
def test_no_unit_goes_further_than_faces_do(rig, actor):
    rig = actor_rig(actor) if actor else rig
    peak = dict(zip(UNITS, np.linalg.norm(rig.deltas, axis=2).max(1), strict=True))
    assert max(peak.values()) < 40.0
    assert max(p for name, p in peak.items() if name not in JAW) < 18.0


@pytest.mark.parametrize("unit", [u for u in UNITS if u not in JAW])
def test_units_are_local(rig, unit):
    d = rig.deltas[UNITS.index(unit)]
    area = np.bincount(rig.neutral.faces.ravel(), np.repeat(rig.neutral.face_areas / 3, 3))
    energy = area * (d**2).sum(1)
    peak = np.linalg.norm(d, axis=1).argmax()
    sources = [peak] if unit[-1] in "LR" else [peak, rig.template.mirror[peak]]
    V = rig.neutral.vertices
    away = np.linalg.norm(V[:, None] - V[sources], axis=2).min(1)
    assert energy[away < 45.0].sum() > 0.9 * energy.sum()


def test_one_sided_units_leave_the_other_side_alone(rig):
    for unit in (u for u in UNITS if u[-1] == "L" and u not in JAW):
        moved = np.linalg.norm(rig.deltas[UNITS.index(unit)], axis=1)
        other = rig.neutral.vertices[:, 0] < -20.0
        assert moved[other].max() < 0.25 * moved.max(), unit


# --- eyes -----------------------------------------------------------------------------------


def to_polyline(points, line):
    """Distance of points (n, 3) from a polyline (m, 3)."""
    a, step = line[:-1], np.diff(line, axis=0)
    t = np.einsum("nmd,md->nm", points[:, None] - a, step) / (step**2).sum(1)
    foot = a + np.clip(t, 0, 1)[..., None] * step
    return np.linalg.norm(points[:, None] - foot, axis=2).min(1)


@pytest.mark.parametrize("actor", [None, *ACTORS])
@pytest.mark.parametrize("side", ["left", "right"])
def test_lids_close_until_they_meet(rig, actor, side):
    rig = actor_rig(actor) if actor else rig
    X = rig.shape({"AU45" + side[0].upper(): 1.0})
    for edge in ("lid", "lid_back"):
        upper, lower = (
            X[rig.template.curves[f"{lid}_{edge}_{side}"]] for lid in ("upper", "lower")
        )
        assert max(to_polyline(upper, lower).max(), to_polyline(lower, upper).max()) < 0.3


@pytest.mark.parametrize("actor", [None, *ACTORS])
def test_closed_lids_neither_pinch_nor_cut_into_each_other(rig, actor):
    rig = actor_rig(actor) if actor else rig
    X, F = rig.shape({"AU45": 1.0}), rig.neutral.faces
    half = F[(X[F, 0] >= 0.0).all(1)]
    assert np.mean(angles(X, half).min(1) >= 15.0) > 0.99
    # none, but for the folded skin behind the inner corner of the eye
    assert len(self_intersections(X, half)) < 0.003 * len(half)
    line = X[rig.template.curves["upper_lid_left"]][1:-1]
    steps = np.diff(line, axis=0)
    steps /= np.linalg.norm(steps, axis=1)[:, None]
    turn = np.degrees(np.arccos(np.clip((steps[1:] * steps[:-1]).sum(1), -1.0, 1.0)))
    assert turn.max() < 20.0  # no hook at a canthus


def test_lids_never_enter_the_eyeball(rig, shapes):
    for centre, radius in rig.template.eyeballs.values():
        rest = np.linalg.norm(rig.neutral.vertices - centre, axis=1)
        now = np.linalg.norm(shapes - centre, axis=2)
        # where the template itself tucks skin behind the lid, it gets no deeper
        assert (now - np.minimum(rest, radius)).min() > -1e-6


def test_lids_never_cross(rig, shapes):
    for side, (centre, radius) in rig.template.eyeballs.items():
        upper, lower = (rig.template.curves[f"{lid}_lid_{side}"] for lid in ("upper", "lower"))
        ends = rig.neutral.vertices[upper[[0, -1]]]
        across = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        up = np.cross(across, [0.0, 0.0, 1.0])
        up *= np.sign(up[1]) / np.linalg.norm(up)
        forward = np.cross(up, across)
        forward *= np.sign(forward[2])

        def elevation(X, centre=centre, up=up, forward=forward):
            return np.arctan2((X - centre) @ up, (X - centre) @ forward)

        for X in shapes:
            edge = np.interp(X[upper] @ across, X[lower] @ across, elevation(X[lower]))
            assert radius * (edge - elevation(X[upper])).max() < 0.1  # mm along the lid


def test_closing_and_raising_the_lids_still_closes_them(rig):
    X = rig.shape({"AU45": 1.0, "AU5": 1.0, "AU7": 1.0})
    upper, lower = (X[rig.template.curves[f"{lid}_lid_left"]] for lid in ("upper", "lower"))
    assert to_polyline(upper, lower).max() < 0.3


# --- lips and skin --------------------------------------------------------------------------


def lip_gaps(rig, W):
    """Height of the upper lip's inner rim over the lower one's, (n_frames, n_rim - 2), mm."""
    rims = [rig.template.curves[f"{lip}_lip_inner"] for lip in ("upper", "lower")]
    order = np.unique(np.concatenate(rims))
    gaps = []
    for X in rig.animate(W, order):
        upper, lower = (X[np.searchsorted(order, rim)] for rim in rims)
        gaps.append(upper[1:-1, 1] - np.interp(upper[1:-1, 0], lower[:, 0], lower[:, 1]))
    return np.array(gaps)


@pytest.mark.parametrize("actor", [None, *ACTORS])
def test_lips_do_not_pass_through_each_other(rig, weights, actor):
    rig = actor_rig(actor) if actor else rig
    assert lip_gaps(rig, weights).min() > -0.05  # mm


@pytest.mark.parametrize("actor", [None, *ACTORS])
def test_closed_lips_meet_and_stay_closed(rig, actor):
    rig = actor_rig(actor) if actor else rig
    closed = [rig.weights_of({})]
    closed += [rig.weights_of({unit: w}) for unit in CLOSED for w in (0.3, 0.7, 1.0)]
    gaps = lip_gaps(rig, np.array(closed))
    assert gaps.min() >= 0.0
    assert gaps.max() < 0.3  # mm


def test_lips_would_cross_without_contact(rig):
    pressed = rig.weights_of({"AU17": 1.0, "AU24": 1.0})
    upper, lower = (rig.template.curves[f"{lip}_lip_inner"] for lip in ("upper", "lower"))
    linear = rig.neutral.vertices + np.tensordot(pressed, rig._muscles, axes=1)
    gap = linear[upper, 1] - np.interp(linear[upper, 0], linear[lower, 0], linear[lower, 1])
    assert gap.min() < -2.0


@pytest.mark.parametrize("actor", [None, *ACTORS])
def test_hardly_a_triangle_turns_over_at_a_peak(rig, actor):
    rig = actor_rig(actor) if actor else rig
    F, V = rig.neutral.faces, rig.neutral.vertices

    def normals(X):
        return np.cross(X[F[:, 1]] - X[F[:, 0]], X[F[:, 2]] - X[F[:, 0]])

    for name, d in zip(UNITS, rig.deltas, strict=True):
        turned = (normals(V) * normals(V + d)).sum(1) < 0.0
        assert turned.mean() < 0.005, name


# --- jaw and combinations -------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["AU29", "AU30L"])
def test_the_jaw_moves_rigidly(rig, unit):
    chin = rig.template.regions["chin"]
    chin = chin[rig._jaw.weights[chin] > 0.999]
    assert len(chin) > 100
    before, after = rig.neutral.vertices[chin], rig.shape({unit: 1.0})[chin]
    lengths = [np.linalg.norm(P[:, None] - P, axis=2) for P in (before, after)]
    np.testing.assert_allclose(*lengths, atol=0.02)  # weights are within 0.1 % of 1


def test_the_jaw_swings_on_an_arc(rig):
    chin = rig.neutral.landmarks["chin"]
    half, full = (rig.shape({"AU26": w})[chin] - rig.neutral.vertices[chin] for w in (0.5, 1.0))
    bend = np.linalg.norm(half - 0.5 * full)
    assert bend > 0.1  # mm off the straight path


def test_a_unit_alone_is_its_displacement(rig):
    for k in (0, 8, 20, 30, 34):
        weights = np.eye(40)[k]
        np.testing.assert_allclose(
            rig.shape(weights), rig.neutral.vertices + rig.deltas[k], atol=1e-12
        )
    np.testing.assert_array_equal(rig.shape(np.zeros(40)), rig.neutral.vertices)


def test_an_open_jaw_carries_the_lower_lip_and_is_not_a_sum(rig):
    weights = {"AU27": 1.0, "AU16": 1.0}
    off = np.linalg.norm(rig.shape(weights) - rig.linear().shape(weights), axis=1)
    assert off.max() > 1.0
    assert off[rig.template.regions["forehead"]].max() < 1e-2


def test_units_that_pull_the_same_skin_saturate(rig):
    corner = rig.neutral.landmarks["mouth_corner_left"]
    weights = {"AU12L": 1.0, "AU11L": 1.0, "AU13": 1.0}
    moved = rig.shape(weights)[corner] - rig.neutral.vertices[corner]
    summed = rig.linear().shape(weights)[corner] - rig.neutral.vertices[corner]
    strongest = np.linalg.norm(at(rig, "AU12L", "mouth_corner_left"))
    assert strongest < np.linalg.norm(moved) < 0.92 * np.linalg.norm(summed)


# --- the interface --------------------------------------------------------------------------


def test_animate_is_shape_frame_by_frame(rig, weights, shapes):
    some = np.random.default_rng(0).permutation(8820)[:400]
    part = rig.animate(weights, some)
    np.testing.assert_allclose(part, shapes[:, some], atol=1e-9)
    for f in (0, 9, 150):
        np.testing.assert_allclose(shapes[f], rig.shape(weights[f]), atol=1e-9)


def test_no_frames_and_all_frames_at_rest_are_fine(rig):
    assert rig.animate(np.zeros((0, 40))).shape == (0, 8820, 3)
    np.testing.assert_array_equal(rig.animate(np.zeros((3, 40)))[2], rig.neutral.vertices)


def test_a_sequence_runs_from_rest_over_the_peak_to_rest(rig):
    frames = rig.unit_sequence("AU27", n_frames=21)
    moved = np.linalg.norm(frames - rig.neutral.vertices, axis=2).max(1)
    assert frames.shape == (21, 8820, 3)
    assert moved[0] == moved[-1] == 0.0
    peak = rig.neutral.vertices + rig.deltas[UNITS.index("AU27")]
    np.testing.assert_allclose(frames[moved.argmax()], peak, atol=1e-9)
    assert (np.diff(np.sign(np.diff(moved))) != 0).sum() == 1  # one peak


def test_the_linear_rig_has_the_same_units(rig):
    linear = rig.linear()
    assert isinstance(linear, BlendshapeRig)
    assert linear.names == UNITS
    np.testing.assert_array_equal(linear.deltas, rig.deltas)


def test_a_name_without_a_side_is_both_sides(rig):
    np.testing.assert_array_equal(
        rig.weights_of({"AU12": 0.5}), rig.weights_of({"AU12L": 0.5, "AU12R": 0.5})
    )


def test_skin_of_different_stiffness_answers_in_different_shapes(rig):
    slack = ActionUnitRig(rig.template, ACTORS["M2"].style)
    a, b = (r.deltas.reshape(40, -1) for r in (rig, slack))
    cosines = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    assert cosines.min() < 0.97  # not only amplitude
    assert np.median(cosines) > 0.9  # still the same units


def test_actors_share_vertices_and_are_made_once():
    assert actor_rig("M1") is actor_rig("M1")
    rest = [actor_rig(a).neutral for a in ("M1", "F2")]
    np.testing.assert_array_equal(rest[0].faces, rest[1].faces)
    assert rest[0].landmarks == rest[1].landmarks


def test_a_kept_rig_is_the_made_one_bit_for_bit_and_what_is_in_doubt_is_made_again(
    tmp_path, monkeypatch
):
    def fails(*_):
        raise RuntimeError("made again")

    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))
    get, f2 = actor_rig.__wrapped__, ACTORS["F2"]
    made = ActionUnitRig(build_template(f2.anatomy, 1500), f2.style)
    first = get("F2", 1500)
    with monkeypatch.context() as kept:
        kept.setattr("data_synth.action_units._muscle_fields", fails)
        again = get("F2", 1500)
        for rig in (first, again):
            for name in ("_muscles", "deltas"):
                assert getattr(rig, name).tobytes() == getattr(made, name).tobytes()
            assert rig.neutral.vertices.tobytes() == made.neutral.vertices.tobytes()
        shutil.copytree(tmp_path / "rigs" / "F2-1500", tmp_path / "rigs" / "M1-1500")
        with pytest.raises(RuntimeError, match="made again"):  # another actor's
            get("M1", 1500)
        file = tmp_path / "rigs" / "F2-1500" / "arrays.npz"
        file.write_bytes(file.read_bytes()[:-100])
        with pytest.raises(RuntimeError, match="made again"):
            get("F2", 1500)
    np.testing.assert_array_equal(get("F2", 1500).deltas, made.deltas)


def test_unknown_names_are_refused_with_the_known_ones(rig):
    with pytest.raises(ValueError, match=r"AU99.*AU12L"):
        rig.shape({"AU99": 1.0})
    with pytest.raises(ValueError, match=r"AU12'.*AU12L"):
        rig.unit_sequence("AU12")
    with pytest.raises(ValueError, match=r"M9.*M1"):
        actor_rig("M9")


def test_bad_weights_and_vertices_are_refused(rig):
    with pytest.raises(ValueError, match=r"W has shape"):
        rig.animate(np.zeros((5, 39)))
    with pytest.raises(ValueError, match=r"weights has shape"):
        rig.shape(np.zeros(3))
    with pytest.raises(ValueError, match=r"NaN"):
        rig.animate(np.full((2, 40), np.nan))
    with pytest.raises(ValueError, match=r"NaN"):
        rig.shape({"AU1": np.inf})
    with pytest.raises(ValueError, match=r"8820"):
        rig.animate(np.zeros((1, 40)), [0, 8820])
    with pytest.raises(ValueError, match=r"3 or more"):
        rig.unit_sequence("AU1", n_frames=2)
    with pytest.raises(TypeError, match=r"style"):
        ActionUnitRig(rig.template, "soft")
    assert Style() == Style(spread=1.0)


# --- against a scanned face -------------------------------------------------------------------


@pytest.mark.real
def test_units_point_the_way_a_scanned_face_moves(rig, real_rig):
    rows = compare(rig, real_rig)
    assert [r.unit for r in rows] == [u for u in UNITS if UNIT_TABLE[u].ict]
    cosines = np.array([r.cosine for r in rows])
    assert np.median(cosines) > 0.6
    assert cosines.min() > 0.3
