"""Takes with garbage in them: judged frame by frame, marker by marker, and said so."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import facelab
from data_synth.template import build_template
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.motion import MarkerSequence
from facelab.registration import Fault, fit_markers, register_sequence, rest_markers, sequence
from facelab.studies.marker_faults import thinned

KEEP = ("chin", "nose_tip", "nose_bridge_1", "mouth_corner_left", "mouth_corner_right", "lip_upper",
        "brow_left_1", "brow_right_1", "brow_left_5", "brow_right_5")  # fmt: skip
LARGE = 1e300


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def template():
    face = build_template(n_vertices=3000)
    names = dict(zip(MULTI_PIE, face.landmarks.tolist(), strict=True))
    return TriangleMesh(face.vertices, face.faces, names)


@pytest.fixture(scope="module")
def capture():
    return facelab.data.load_capture("M1", size="small", progress=False)


@pytest.fixture(scope="module")
def fit(template, capture):
    """Of the markers at rest, no two nearer than 12 mm."""
    takes = [capture.markers(name) for name in capture.texts]
    rest = rest_markers(takes)
    return fit_markers(template, *rest_markers([thinned(t, *rest, 12.0, KEEP) for t in takes]))


@pytest.fixture(scope="module")
def take(fit, capture):
    """Without faults, save that markers are hidden."""
    return capture.markers("rage_1").select(fit.names)


@pytest.fixture(scope="module")
def clean(fit, take):
    return register(fit, take)


@pytest.fixture(scope="module")
def sparse(template, take, fit):
    """A layout of markers 30 mm apart, and a take of it in which a brow rises by 12 mm, and falls.

    The skin beside it stays, so that the others lead the brow elsewhere.
    """
    few = thinned(take, fit.rest, fit.names, 30.0, KEEP)
    rest = fit.rest[[fit.names.index(n) for n in few.names]]
    rise = np.concatenate([np.zeros(40), np.linspace(0, 1, 20), np.ones(15), np.linspace(1, 0, 20)])
    rise = np.sin(np.pi / 2 * np.append(rise, np.zeros(40))) ** 2
    brow = few.names.index("brow_left_1")
    P = np.repeat(rest[None], len(rise), axis=0)
    P[:, brow] += 12 * rise[:, None] * [0, 0.8, 0.6]
    return fit_markers(template, rest, few.names), MarkerSequence(P, few.names, 60)


def register(fit, take, **options):
    return register_sequence(fit, take, progress=False, **options)


def changed(take, change):
    """The take with `change` done to a copy of its positions, in place or given back."""
    P = take.positions.astype(float)
    made = change(P)
    return MarkerSequence(P if made is None else made, take.names, take.fps)


def scattered(P):
    return P[:, np.random.default_rng(1).permutation(P.shape[1])]


GARBAGE = {
    "zeros": (lambda P: 0 * P, "all markers in one point"),
    "one point": (lambda P: 0 * P + [10, 20, 30], "all markers in one point"),
    "far away": (lambda P: np.full_like(P, LARGE), "all markers in one point"),
    "noise": (lambda P: np.random.default_rng(0).normal(0, 40, P.shape), "mm from their places"),
    "wild": (lambda P: np.random.default_rng(0).normal(0, LARGE, P.shape), "from their places"),
    "shaken": (lambda P: P + np.random.default_rng(0).normal(0, 12, P.shape), "from their places"),
    "mirrored": (lambda P: P * [-1, 1, 1], "mirrored"),
    "metres": (lambda P: P / 1000, "0.001 times the size of the face"),
    "micrometres": (lambda P: P * 1000, "1e+03 times the size of the face"),
    "large": (lambda P: P * 1.25, " times the size of the face"),
    "small": (lambda P: P * 0.75, " times the size of the face"),
    "scattered": (scattered, "mm from their places"),
    "a line": (
        lambda P: np.zeros_like(P) + np.arange(P.shape[1])[:, None] * [1, 2, 0],
        "markers on one line",
    ),
    "hidden": (lambda P: np.full_like(P, np.nan), "fewer than three markers"),
}


# --- frames ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", GARBAGE)
def test_garbage_frames_are_not_valid_and_said_why_and_move_no_other(kind, fit, take):
    garbage, reason = GARBAGE[kind]
    frames = np.array([30, 31, 32, 33, 90, 140])

    def spoil(P):
        P[frames] = garbage(P[frames])

    before = register(fit, take, bridge=0)  # bridges lead from frame to frame
    found = register(fit, changed(take, spoil), bridge=0)
    assert np.flatnonzero(~found.valid).tolist() == frames.tolist()
    said = [f for f in found.faults if f.kind == "frame"]
    assert [(f.first, f.stop) for f in said] == [(30, 34), (90, 91), (140, 141)]
    assert all(reason in f.reason for f in said) and all(f.names == () for f in said)
    assert f"{len(take.valid)} frames, 6 lost" in repr(found) and reason in found.report
    others = found.valid
    assert np.abs(found.displacements - before.displacements)[others].max() < 0.1
    assert np.isnan(found.positions([31])).all() and np.isnan(found.head.rotation[31]).all()
    assert not found.motion().valid[frames].any() and not found.seen[frames].any()


@pytest.mark.parametrize("seed", range(4))
def test_whatever_garbage_comes_in_the_other_frames_are_as_they_were(seed, fit, take):
    rng = np.random.default_rng(seed)
    kinds = list(GARBAGE)
    bad = rng.choice(take.n_frames, 40, replace=False)

    def spoil(P):
        for frame in bad:
            garbage, _ = GARBAGE[kinds[rng.integers(len(kinds))]]
            P[frame] = garbage(P[frame : frame + 1])[0]

    before = register(fit, take, bridge=0)
    found = register(fit, changed(take, spoil), bridge=0)
    assert set(np.flatnonzero(~found.valid)) == set(bad)
    assert np.abs(found.displacements - before.displacements)[found.valid].max() < 0.2


def test_garbage_at_the_start_or_in_most_frames_does_not_refuse_the_take(fit, take):
    bad = np.flatnonzero(np.arange(take.n_frames) % 5 < 3)  # more than half, each with all markers

    def spoil(P):
        P[bad] = np.random.default_rng(0).normal(0, 40, P[bad].shape)

    assert (np.flatnonzero(~register(fit, changed(take, spoil)).valid) == bad).all()


@pytest.mark.parametrize("share", [0, 0.2, 0.5])
@pytest.mark.parametrize("name", ["rage_1", "pride_5"])
def test_no_frame_and_no_marker_of_a_clean_take_is_thrown_away(name, share, fit, capture):
    given = capture.markers(name).select(fit.names).with_gaps(share, random_state=0)
    found = register(fit, given)
    assert found.valid.all() and not [f for f in found.faults if f.kind in ("frame", "stray")]
    assert found.share_rejected == 0 and np.isnan(found.rms_rejected)
    assert "nothing thrown away" in repr(found)


@pytest.mark.parametrize("share", [0, 0.4])
def test_a_jaw_wide_open_and_a_turned_head_are_no_fault(share, fit):
    """The jaw drops by 45 mm in a quarter of a second while the head turns by 60 degrees."""
    low = 1 / (1 + np.exp((fit.rest[:, 1] - fit.rest[fit.names.index("lip_upper"), 1] + 6) / 3))
    t = np.arange(240) / 60
    open_ = 45 * np.exp(-(((t - 2) / 0.35) ** 2)) + 30 * np.exp(-(((t - 3.2) / 0.16) ** 2))
    P = fit.rest + open_[:, None, None] * low[:, None] * [0, -0.9, -0.4]
    angle = np.radians(60) * np.sin(2 * t)
    turn = np.zeros((len(t), 3, 3))
    turn[:, 0, 0] = turn[:, 2, 2] = np.cos(angle)
    turn[:, 0, 2], turn[:, 2, 0], turn[:, 1, 1] = np.sin(angle), -np.sin(angle), 1
    P = np.einsum("fij,fmj->fmi", turn, P) + [300, 1500, 20]
    found = register(fit, MarkerSequence(P, fit.names, 60).with_gaps(share, random_state=0))
    assert not [f for f in found.faults if f.kind != "gap"]


def test_a_take_that_is_wrong_all_through_gets_its_own_error(fit, take):
    for change, message in (
        (lambda P: P[:0], "no frames"),
        (lambda P: P / 1000, "metres: multiply by 1000"),
        (lambda P: P / 10, "centimetres: multiply by 10"),
        (lambda P: P * 1.25, "1.25 times the size of the face that was fitted"),
        (lambda P: 0 * P, "in one point"),
        (lambda P: P * [1, 1, -1], "mirrored"),
        (lambda P: scattered(P), "another layout"),
        (lambda P: P * LARGE, "times the size of the face"),
    ):
        with pytest.raises(ValueError, match=message):
            register(fit, changed(take, change))


def test_a_take_of_one_frame_is_registered(fit, take, clean):
    alone = register(fit, take[50:51], bridge=0)
    assert alone.valid.tolist() == [True]
    assert np.abs(alone.displacements[0] - clean.displacements[50]).max() < 3


# --- markers --------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [[LARGE] * 3, [LARGE, -LARGE, 0], [np.finfo(float).max] * 3])
def test_one_marker_beyond_all_measure_is_a_stray_and_its_frame_stays(place, fit, take, clean):
    marker = fit.names.index("nose_tip")

    def spoil(P):
        P[50, take.names.index("nose_tip")] = place

    found = register(fit, changed(take, spoil))  # and no warning of an overflow
    assert found.valid.all() and not found.seen[50, marker]
    assert Fault("stray", 50, 51, ("nose_tip",)) in found.faults
    assert np.abs(found.displacements - clean.displacements).max() < 1
    assert found.rms_rejected > 1e299 and len(repr(found)) < 300
    with pytest.raises(ValueError, match="infinite values, 1 in all, the first is nose_tip"):
        changed(take, lambda P: P.__setitem__((50, take.names.index("nose_tip")), np.inf))


def test_the_peak_of_a_marker_without_near_neighbours_is_kept(sparse):
    fit, take = sparse
    found = register(fit, take)
    brow = fit.names.index("brow_left_1")
    off = fit.layout.left_out(found.displacements.astype(float))[:, brow]
    assert np.linalg.norm(off, axis=1).max() > 8  # 8 mm were the limit for all layouts
    assert found.seen.all() and not found.faults
    fixed = register(fit, take, limit=5.0)  # as a limit would have it
    assert {f.names for f in fixed.faults if f.kind == "stray"} >= {("brow_left_1",)}


@pytest.mark.parametrize("length", [1, 2, 12, 30])
@pytest.mark.parametrize("at", [10, 65])
def test_a_jump_away_and_back_is_a_stray_at_rest_and_on_the_peak(sparse, length, at):
    fit, take = sparse
    column = take.names.index("brow_left_1")

    def spoil(P):
        P[at : at + length, column] += [10, -8, 9]

    found = register(fit, changed(take, spoil))
    assert [f for f in found.faults if f.kind != "gap"] == [
        Fault("stray", at, at + length, ("brow_left_1",))
    ]


def test_a_marker_that_never_was_where_its_name_says_is_left_out(fit, take):
    column = take.names.index("chin")

    def spoil(P):
        P[:, column] = P[:, take.names.index("nose_tip")] + [0, 0, 3]

    found = register(fit, changed(take, spoil))
    chin = fit.names.index("chin")
    assert not found.seen[:, chin].any() and found.valid.all()


def test_a_stray_takes_neither_its_neighbours_nor_the_head_with_it(fit, take, clean):
    marker = "nose_bridge_1"  # most rigid, so that the head leans on it
    column = take.names.index(marker)
    hidden = ~take.visible[100:120, column]

    def spoil(P):
        P[100:120, column] += [25, 20, 5]

    found = register(fit, changed(take, spoil))
    strays = {f.names for f in found.faults if f.kind == "stray"}
    assert strays == {(marker,)}
    lost = ~found.seen[100:120, fit.names.index(marker)]
    assert lost.all() and not hidden.all()
    assert np.abs(found.head.translation - clean.head.translation).max() < 0.3


def test_names_exchanged_far_apart_are_put_back(fit, take, clean):
    a, b = (take.names.index(n) for n in ("chin", "brow_left_1"))
    first = next(f for f in range(20, 150) if take.visible[f : f + 12][:, [a, b]].all())

    def spoil(P):
        P[first : first + 12, [a, b]] = P[first : first + 12, [b, a]]

    found = register(fit, changed(take, spoil))
    swaps = [f for f in found.faults if f.kind == "swap"]
    assert [(f.first, f.stop, set(f.names)) for f in swaps] == [
        (first, first + 12, {"chin", "brow_left_1"})
    ]
    assert np.abs(found.displacements - clean.displacements).max() < 0.5


# --- what the report counts -----------------------------------------------------------------------


def test_what_was_thrown_away_is_counted_beside_what_was_believed(fit, take, clean):
    column = take.names.index("nose_tip")
    at = np.flatnonzero(take.visible[:, column])[[20, 60, 100]]

    def spoil(P):
        P[at, column] += [0, 0, 20.0]
        P[130] = 0

    found = register(fit, changed(take, spoil))
    given = changed(take, spoil).visible.sum()
    assert found.n_samples == given
    assert found.share_rejected == pytest.approx((3 + take.n_markers) / given)
    assert found.rms_rejected == pytest.approx(20, rel=0.05)
    assert found.rms == pytest.approx(clean.rms, rel=0.02)  # which says nothing of it
    share = 100 * (3 + take.n_markers) / given
    assert f"{share:.2g} % of the samples thrown away" in repr(found)
    assert f"nose_tip strayed, not believed: frame {at[0]}, {at[1]}, {at[2]}" in found.report
    assert "130 (all markers in one point)" in found.report


def test_errors_of_markers_and_frames_are_those_of_the_plain_formula(fit, take, clean):
    off = clean.displacements - fit.layout.smoothed(clean.displacements.astype(float))
    square = np.where(clean.seen, (off**2).sum(axis=2), np.nan)
    assert clean.rms == pytest.approx(np.sqrt(np.nanmean(square)))
    np.testing.assert_allclose(clean.rms_per_frame, np.sqrt(np.nanmean(square, axis=1)))
    np.testing.assert_allclose(clean.rms_per_marker, np.sqrt(np.nanmean(square, axis=0)))


@pytest.mark.parametrize("head", ["rigid", "whole"])
def test_head_and_displacements_together_are_where_the_markers_were_seen(head, fit, take):
    column = take.names.index("nose_bridge_1")
    stray = np.array([40, 41, 42])

    def spoil(P):
        P[stray, column] += [25, 20, 5]

    given = changed(take, spoil)
    found = register(fit, given, head=head)
    back = found.head.to_capture(found.displacements + fit.rest)
    order = [given.names.index(n) for n in fit.names]
    off = (back - given.positions[:, order])[found.seen]
    assert np.abs(off).max() < 1e-3  # float32


# --- long takes -----------------------------------------------------------------------------------


def test_blocks_leave_no_trace(fit, take, monkeypatch):
    column = take.names.index("nose_tip")

    def spoil(P):
        P[60:66, column] += [0, 0, 20.0]  # across the edge of a block
        P[127:130] = 0

    given = changed(take, spoil)
    whole = register(fit, given)
    monkeypatch.setattr(sequence, "_BLOCK", 32)
    parts = register(fit, given)
    assert parts.faults == whole.faults
    np.testing.assert_array_equal(parts.seen, whole.seen)
    np.testing.assert_allclose(parts.displacements, whole.displacements, atol=1e-4)


def test_dense_frames_go_to_an_array_or_a_file_as_they_are(fit, take, clean, tmp_path):
    plain = clean.positions()
    out = np.empty_like(plain)
    assert clean.positions(out=out) is out
    np.testing.assert_array_equal(out, plain)
    path = tmp_path / "dense.npy"
    mapped = clean.positions(out=path)
    assert isinstance(mapped, np.memmap) and not mapped.flags.writeable
    np.testing.assert_array_equal(mapped, plain)
    assert [p.name for p in tmp_path.iterdir()] == ["dense.npy"]
    vertices, mesh = fit.mesh.subsample(397)
    motion = clean.motion(vertices, mesh, out=str(tmp_path / "few.npy"))
    np.testing.assert_array_equal(motion.positions, np.load(tmp_path / "few.npy"))
    with pytest.raises(ValueError, match="out has shape"):
        clean.positions(out=out[1:])
    with pytest.raises(TypeError, match="out is a list"):
        clean.positions(out=[1])
    with pytest.raises(FileNotFoundError, match="does not exist"):
        clean.positions(out=tmp_path / "no" / "dense.npy")


def test_a_stop_while_a_file_is_written_leaves_nothing_behind(clean, tmp_path, monkeypatch):
    path = tmp_path / "dense.npy"
    path.write_bytes(b"what was there")

    class Stopped:
        def __init__(self, **options):
            self.blocks = 0

        def __enter__(self):
            return self

        def __exit__(self, *error):
            return False

        def update(self, count):
            self.blocks += 1
            if self.blocks == 3:
                raise KeyboardInterrupt

    monkeypatch.setattr(sequence, "tqdm", Stopped)
    with pytest.raises(KeyboardInterrupt):
        clean.positions(block=20, out=path)
    assert [p.name for p in tmp_path.iterdir()] == ["dense.npy"]
    assert path.read_bytes() == b"what was there"


def test_what_is_held_of_a_long_take_is_its_result(fit, take):
    long = np.tile(take.positions.astype(np.float32), (20, 1, 1))
    found = register(fit, MarkerSequence(long, take.names, 120))
    assert found.displacements.dtype == np.float32
    held = found.displacements.nbytes + found.seen.nbytes + found.head.rotation.nbytes
    held += found.head.translation.nbytes + found.rejected.nbytes
    assert held < 1.3 * long.nbytes
    assert replace(found, faults=()).rms == pytest.approx(found.rms)


def test_a_second_actor_in_the_take_is_left_out_and_said(template, fit, take, clean):
    room = MarkerSequence(
        np.concatenate([take.positions, take.positions[::-1] + [500, 0, 0]], axis=1),
        [*take.names, *(f"{name}_2" for name in take.names)],
        take.fps,
    )
    home = fit.alignment.inverse().apply(fit.rest)
    names = [*fit.names, *(f"{name}_2" for name in fit.names)]
    with pytest.warns(UserWarning, match="somebody else"):
        both = fit_markers(template, np.vstack([home, home + [500, 0, 0]]), names)
    found = register(both, room)
    assert len(found.left_out) == len(fit.names)
    assert f"{len(fit.names)} marker(s) left out as none of the face" in repr(found)
    assert "left out, as they lie off the face at rest: " in found.report
    assert np.allclose(found.positions(slice(0, 50)), clean.positions(slice(0, 50)), atol=0.1)


@pytest.mark.parametrize(("n_more", "fps", "rise"), [(5, 30, 4), (26, 30, 3), (26, 25, 2)])
def test_a_jaw_that_snaps_open_at_a_low_rate_loses_no_marker(n_more, fps, rise):
    """Its lip outruns where the others lead it by more than 3 mm a frame, but goes along."""
    rig = facelab.load_example().rig
    face, jaw = rig.neutral, rig.deltas[rig.names.index("jawOpen")]
    names = [*KEEP, "lip_lower", "eye_left_outer", "eye_right_outer", "nostril_left_outer",
             "nostril_right_outer"]  # fmt: skip
    sites = [face.landmarks[n] for n in names]
    moves = np.flatnonzero((np.linalg.norm(jaw, axis=1) > 1) & (face.normals[:, 2] > 0.2))
    skin = moves[face.pieces[moves] == face.pieces[sites[0]]]
    for _ in range(n_more):
        apart = np.linalg.norm(face.vertices[skin, None] - face.vertices[sites], axis=2)
        sites.append(int(skin[apart.min(axis=1).argmax()]))
    names += [f"m{i}" for i in range(n_more)]
    up = np.linspace(0, 1, rise + 1)[1:]
    once = np.concatenate([np.zeros(30), up, np.ones(fps // 3), up[::-1], np.zeros(200)])
    P = face.vertices[sites] + once[:, None, None] * jaw[sites]
    P += np.random.default_rng(0).normal(0, 0.1, P.shape)
    take = MarkerSequence(P, names, fps)
    found = register(fit_markers(face, *rest_markers(take), offset=0), take)
    assert found.seen.all() and not found.faults
    lone = P.copy()
    lone[40:44, names.index("lip_lower")] += [14, 0, 8]  # while the mouth is open
    found = register(found.fit, MarkerSequence(lone, names, fps))
    assert [(f.kind, f.names) for f in found.faults] == [("stray", ("lip_lower",))]
