import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shapes import grid_mesh, sphere_mesh

from data_synth.action_units import actor_rig
from facelab.expression import prepare_units, regress_expression
from facelab.expression.riding import Rider
from facelab.expression.transfer import (
    METHODS,
    IntermediateSpace,
    SimplifiedRig,
    UnitCarrier,
)
from facelab.geometry.mesh import TriangleMesh
from facelab.rig import BlendshapeRig

TURN = Rotation.from_euler("xyz", [10, -35, 5], degrees=True).as_matrix()
SHIFT = np.array([12.0, -40.0, 7.0])


@pytest.fixture(scope="module")
def actors():
    return {name: actor_rig(name, 4375) for name in ("M1", "F1")}


@pytest.fixture(scope="module")
def space(actors):
    return IntermediateSpace(actors["M1"].linear(), actors["F1"].neutral, register=True)


@pytest.fixture
def bump(sphere, rng):
    """Two displacements of a sphere that leave more than half of it still."""
    near = np.exp(-((np.linalg.norm(sphere.vertices - sphere.vertices[0], axis=1) / 20) ** 2))
    near[near < 0.05] = 0
    return near[None, :, None] * rng.normal(scale=5, size=(2, 1, 3))


def rms(off):
    return np.sqrt((off**2).sum(axis=-1).mean())


# -- Carrying --


@pytest.mark.parametrize("method", METHODS)
def test_a_unit_carried_to_the_same_face_stays_as_it_is(sphere, bump, method):
    carried = UnitCarrier(sphere, sphere, method).carry(bump)
    np.testing.assert_allclose(carried, bump, atol=1e-5)


def test_on_a_turned_and_larger_face_mapped_units_turn_and_grow(sphere, bump):
    target = sphere.with_vertices(1.7 * sphere.vertices @ TURN.T + SHIFT)
    carried = UnitCarrier(sphere, target, "mapping").carry(bump)
    np.testing.assert_allclose(carried, 1.7 * bump @ TURN.T, atol=1e-9)


def test_on_a_larger_face_transferred_units_grow(sphere, bump):
    target = sphere.with_vertices(1.7 * sphere.vertices + SHIFT)
    carried = UnitCarrier(sphere, target, "transfer").carry(bump)
    np.testing.assert_allclose(carried, 1.7 * bump, atol=1e-5)


def test_copied_units_neither_turn_nor_grow(sphere, bump):
    target = sphere.with_vertices(1.7 * sphere.vertices @ TURN.T)
    np.testing.assert_array_equal(UnitCarrier(sphere, target, "copy").carry(bump), bump)


def test_mapping_stretches_with_a_wider_face_along_its_surface():
    flat = grid_mesh(9, 8, spacing=5.0)
    wide = flat.with_vertices(flat.vertices * [2.0, 1.0, 1.0])
    d = np.tile([1.0, 1.0, 0.0], (1, flat.n_vertices, 1))
    carried = UnitCarrier(flat, wide, "mapping").carry(d)
    np.testing.assert_allclose(carried, d * [2, 1, 1], atol=1e-9)


def test_mapping_over_a_wider_reach_varies_less_over_the_face(actors):
    meshes = actors["M1"].neutral, actors["F1"].neutral
    spread = [
        UnitCarrier(*meshes, "mapping", reach=r).change.std(axis=0).max() for r in (5, 20, 80)
    ]
    assert spread[0] > 1.2 * spread[1] > 1.2**2 * spread[2]


def test_deformation_transfer_agrees_with_the_fourth_vertex_formula_of_its_authors(rng):
    mesh = sphere_mesh(1, radius=30.0)
    target = mesh.with_vertices(
        mesh.vertices * [1.3, 0.9, 1.1] + rng.normal(scale=1, size=mesh.vertices.shape)
    )
    d = rng.normal(scale=2, size=(1, *mesh.vertices.shape))
    carried = UnitCarrier(mesh, target, "transfer").carry(d)[0]
    literal = _fourth_vertex_transfer(mesh, target, d[0])
    off = carried - literal
    np.testing.assert_allclose(off, np.tile(off[0], (len(off), 1)), atol=1e-4)  # but for its place


def _fourth_vertex_transfer(source, target, d):
    """Sumner and Popovic 2004, Eq. 3 to 8: every triangle has a fourth vertex of its own."""

    def with_fourth(V, F):
        a, b, c = V[F[0]], V[F[1]], V[F[2]]
        normal = np.cross(b - a, c - a)
        return np.stack([b - a, c - a, normal / np.sqrt(np.linalg.norm(normal))], axis=1)

    n, faces = source.n_vertices, source.faces
    rows, right = [], []
    for i, F in enumerate(faces):
        S = with_fourth(source.vertices + d, F) @ np.linalg.inv(with_fourth(source.vertices, F))
        inverse = np.linalg.inv(with_fourth(target.vertices, F))
        share = np.sqrt(target.face_areas[i])
        for axis in range(3):  # column `axis` of [v2 - v1, v3 - v1, v4 - v1] inverse
            row = np.zeros(n + len(faces))
            for k, v in enumerate((F[1], F[2], n + i)):
                row[v] += inverse[k, axis]
                row[F[0]] -= inverse[k, axis]
            rows.append(share * row)
            right.append(share * S[:, axis])
    x = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0][:n]
    return x - target.vertices


def test_deformation_transfer_leaves_still_skin_in_place(actors):
    source, target = actors["M1"], actors["F1"]
    jaw = source.names.index("AU26")
    d = source.deltas[jaw : jaw + 1]
    still = np.linalg.norm(d[0], axis=1) < 1e-6
    assert still.sum() > 1000
    carried = UnitCarrier(source.neutral, target.neutral, "transfer").carry(d)[0]
    assert rms(carried[still]) < 0.1
    assert rms(carried) > 3


def test_each_piece_of_a_mesh_keeps_its_own_place(sphere, bump):
    n = sphere.n_vertices
    both = TriangleMesh(
        np.vstack([sphere.vertices, sphere.vertices + [200, 0, 0]]),
        np.vstack([sphere.faces, sphere.faces + n]),
    )
    d = np.concatenate([bump, 0 * bump + [0, 3.0, 0]], axis=1)  # the second moves as a whole
    carried = UnitCarrier(both, both, "transfer").carry(d)
    np.testing.assert_allclose(carried, d, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_carried_units_are_near_the_actors_own(actors, method):
    source, target = actors["M1"], actors["F1"]
    carried = UnitCarrier(source.neutral, target.neutral, method).carry(source.deltas)
    assert rms(carried - target.deltas) < 0.25 * rms(target.deltas)


def test_on_a_stretched_face_mapping_stretches_the_units_with_it(actors):
    source = actors["M1"]
    A = np.diag([1.5, 0.8, 1.2])
    wide = source.neutral.with_vertices(source.neutral.vertices @ A.T)
    truth = source.deltas @ A.T
    off = {
        m: rms(UnitCarrier(source.neutral, wide, m).carry(source.deltas) - truth)
        for m in ("mapping", "copy")
    }
    assert off["mapping"] < 0.5 * off["copy"]


# -- The intermediate space --


def test_the_neutral_goes_to_the_template_and_back_exactly(space):
    there = space.to_template(space.target)
    np.testing.assert_allclose(there, space.rig.neutral.vertices, atol=1e-9)
    np.testing.assert_allclose(space.to_target(there), space.target.vertices, atol=1e-9)


def test_an_expression_goes_to_the_template_and_back_within_a_tenth_of_a_millimetre(space, actors):
    V = actors["F1"].shape({"AU12": 0.8, "AU4": 0.5})
    back = space.to_target(space.to_template(V))
    assert rms(back - V) < 0.1


def test_units_of_the_sketch_are_read_through_the_whole_way(actors):
    manner = actors["M1"].linear()
    space = IntermediateSpace(manner, actors["F1"].neutral, register=True)
    sketch = space.to_target(space.rig.shape({"AU12L": 0.9, "AU1": 0.6}))
    fit = regress_expression(space.rig, space.to_template(sketch), lam=0.015)
    w = dict(zip(fit.names, fit.weights[fit.best], strict=True))
    assert w.pop("AU12L") == pytest.approx(0.9, abs=0.05)
    assert w.pop("AU1") == pytest.approx(0.6, abs=0.05)
    assert max(w.values()) < 0.1


def test_a_target_in_another_frame_gets_the_same_expression_there(actors, space):
    target = space.target
    moved = target.with_vertices(target.vertices @ TURN.T + SHIFT)
    other = IntermediateSpace(actors["M1"].linear(), moved)
    assert other.fit is None  # same triangles: taken as it is, in the head frame
    other = IntermediateSpace(actors["M1"].linear(), moved, register=True)
    w = {"AU26": 0.7, "AU12L": 0.5}
    here = space.to_target(space.rig.shape(w)) @ TURN.T + SHIFT
    # a vertex as near to two triangles may ride on either
    np.testing.assert_allclose(other.to_target(other.rig.shape(w)), here, atol=0.05)
    np.testing.assert_allclose(
        other.to_template(moved.vertices), other.rig.neutral.vertices, atol=1e-9
    )


@pytest.mark.parametrize("kind", ["all", "lower face", "left half", "a few", "cut and half"])
def test_a_target_wound_inwards_gets_the_expressions_of_the_other(actors, space, kind):
    target = space.target
    x, y, _ = target.vertices[target.faces].mean(axis=1).T
    which = {
        "all": y < np.inf,
        "lower face": y < -40,
        "left half": x > 0,
        "a few": np.random.default_rng(0).random(len(x)) < 0.05,
        "cut and half": x > 0,
    }[kind]
    V, F = target.vertices, target.faces.copy()
    F[which] = F[which][:, ::-1]
    if kind == "cut and half":  # a seam of the texture between the halves
        V = np.vstack([V, V])
        F[which] += target.n_vertices
    with pytest.warns(UserWarning, match="wound inwards"):
        other = IntermediateSpace(space.source, TriangleMesh(V, F, target.landmarks))
    for unit in ("AU27", "AU12L", "AU45L"):
        here = space.to_target(space.rig.shape({unit: 1}))
        there = other.to_target(other.rig.shape({unit: 1}))
        assert (
            np.linalg.norm(there[: len(here)] - here, axis=1)[np.unique(F[~which])].max(initial=0)
            < 0.05
        )
        if kind != "cut and half":
            np.testing.assert_allclose(other.to_template(here), space.to_template(here), atol=0.05)
    assert other.target.faces.tolist() == F.tolist()


def test_a_source_wound_inwards_is_turned_with_a_word(actors, space):
    mesh = space.source.neutral
    faces = np.where(
        mesh.vertices[mesh.faces].mean(axis=1)[:, :1] > 0, mesh.faces[:, ::-1], mesh.faces
    )
    source = BlendshapeRig(
        TriangleMesh(mesh.vertices, faces, mesh.landmarks), space.source.names, space.source.deltas
    )
    with pytest.warns(UserWarning, match="source: .* of its triangles"):
        other = IntermediateSpace(source, space.target, register=True)
    assert other.rig.neutral.faces.tolist() == faces.tolist()
    here = space.to_target(space.rig.shape({"AU27": 1}))
    np.testing.assert_allclose(other.to_target(other.rig.shape({"AU27": 1})), here, atol=0.05)


def test_without_registration_the_target_is_the_template(actors):
    source, target = actors["M1"].linear(), actors["F1"].neutral
    space = IntermediateSpace(source, target, "copy")
    V = actors["F1"].shape({"AU12": 0.8})
    np.testing.assert_array_equal(space.to_template(V), V)
    np.testing.assert_array_equal(space.to_target(V), V)
    np.testing.assert_array_equal(space.rig.deltas, source.deltas)
    assert "same topology" in repr(space)


def test_what_is_near_the_other_lip_but_faces_away_does_not_follow_it():
    sheet = grid_mesh(9, 9, spacing=5.0)
    upper = sheet.with_vertices(sheet.vertices + [0, 0, 2.0])
    lips = TriangleMesh(
        np.vstack([sheet.vertices, upper.vertices]),
        np.vstack([sheet.faces, upper.faces[:, ::-1] + 81]),
    )
    swollen = sheet.vertices.copy()
    swollen[36:45, 2] = 1.5  # a row of the lower lip comes close to the upper
    rider = Rider(lips, sheet.with_vertices(swollen))
    np.testing.assert_allclose(rider.carry(lips.vertices), swollen, atol=1e-12)
    opened = lips.vertices + np.repeat([[0, -8.0, 0], [0, 0, 9.0]], 81, axis=0)
    np.testing.assert_allclose(rider.carry(opened), swollen + [0, -8.0, 0], atol=1e-9)


def test_a_sketch_of_another_topology_is_fitted(space, actors):
    V = actors["F1"].shape({"AU26": 0.6, "AU2": 0.7})
    mesh = actors["F1"].neutral.with_vertices(V)
    order = np.random.default_rng(0).permutation(mesh.n_vertices)
    place = np.argsort(order)
    shuffled = TriangleMesh(
        mesh.vertices[order],
        place[mesh.faces],
        {name: int(place[v]) for name, v in mesh.landmarks.items()},
    )
    there = space.to_template(shuffled)
    # nothing says where on a cheek a vertex belongs: it may slide along the surface
    assert rms(there - space.to_template(V)) < 2.0
    same = space.to_template(mesh, register=True)  # as if it were a scan
    assert 0.01 < rms(same - space.to_template(V)) < 2.0
    weights = [
        regress_expression(space.rig, W, 0.015).weights for W in (there, space.to_template(V))
    ]
    names = space.rig.names
    assert weights[0][30][names.index("AU26")] == pytest.approx(
        weights[1][30][names.index("AU26")], abs=0.15
    )


def test_the_template_fits_scanned_identities(real_rig, actors):
    space = IntermediateSpace(actors["M1"].linear(), real_rig.neutral)
    assert space.fit.rms < 0.2
    assert "registered" in repr(space)
    V = space.to_target(space.rig.shape({"AU12L": 1.0}))
    moved = np.linalg.norm(V - real_rig.neutral.vertices, axis=1)
    corner = real_rig.neutral.landmarks["mouth_corner_left"]
    assert 5 < moved[corner] < 20
    assert moved[real_rig.neutral.landmarks["mouth_corner_right"]] < 1
    opened = space.to_target(space.rig.shape({"AU27": 1.0}))
    a, b = real_rig.neutral.edges.T
    rest, now = (np.linalg.norm(X[a] - X[b], axis=1) for X in (real_rig.neutral.vertices, opened))
    assert (now - rest).max() < 10  # no triangle spans the open mouth


# -- Brought to life --


def test_a_still_sketch_moves_from_rest_over_its_peak_to_rest(space):
    w = {"AU12L": 0.5, "AU26": 0.3}
    motion = space.bring_to_life(w, n_frames=21, fps=60)
    rest = space.rig.neutral.vertices
    np.testing.assert_allclose(motion.positions[[0, -1]], np.stack([rest, rest]), atol=1e-12)
    np.testing.assert_allclose(motion.positions[8], space.rig.shape(w), atol=1e-9)
    assert motion.fps == 60
    size = [rms(p - rest) for p in motion.positions]
    assert (np.diff(size[:9]) > 0).all()
    assert (np.diff(size[8:]) < 0).all()


def test_recorded_sequences_carried_to_their_own_face_are_theirs(actors):
    actor = actors["M1"]
    space = IntermediateSpace(actor.linear(), actor.neutral, "mapping")
    motion = space.bring_to_life({"AU27": 1.0}, actor.unit_sequence, n_frames=9)
    np.testing.assert_allclose(motion.positions, actor.unit_sequence("AU27", 9), atol=1e-6)
    faint = space.bring_to_life({"AU27": 0.5}, actor.unit_sequence, n_frames=9)
    np.testing.assert_allclose(faint.displacements(), 0.5 * motion.displacements(), atol=1e-9)
    halfway = space.rig.shape({"AU27": 0.5})
    on_arc = min(rms(p - halfway) for p in motion.positions)
    assert on_arc > 0.05  # a jaw does not move on a line


# -- The simplified mesh --


def test_more_vertices_drive_the_full_mesh_better(actors):
    rig = actors["M1"].linear()
    truth = rig.shape({"AU12L": 0.7, "AU26": 0.5})
    off = []
    for n in (200, 397, 1500):
        simple = SimplifiedRig(rig, n)
        off.append(rms(simple.drive(truth[simple.samples]) - truth))
    assert off == sorted(off, reverse=True)
    assert off[-1] < 0.15


@pytest.mark.parametrize("weights", ["uniform", "cotangent"])
def test_units_found_on_the_simplified_mesh_are_those_of_the_full_one(actors, weights):
    rig = actors["M1"].linear()
    simple = SimplifiedRig(rig, weights=weights)
    np.testing.assert_allclose(
        simple.drive(simple.rig.neutral.vertices), rig.neutral.vertices, atol=1e-6
    )
    sketch = rig.shape({"AU12L": 0.7, "AU4": 0.5})
    found = regress_expression(prepare_units(simple.rig), sketch[simple.samples], 0, [0])
    np.testing.assert_allclose(
        found.weights[0], rig.weights_of({"AU12L": 0.7, "AU4": 0.5}), atol=1e-6
    )
    assert rms(simple.drive(found.vertices()) - sketch) < 0.3


def test_what_a_space_gives_may_be_written_on_without_harm(actors):
    rig = actors["M1"].linear()
    space, V = IntermediateSpace(rig, rig.neutral), rig.neutral.vertices.copy()
    assert space.fit is None
    for carry in (space.to_template, space.to_target):
        carried = carry(V)
        np.testing.assert_array_equal(carried, V)
        assert not np.shares_memory(carried, V)


# -- Errors --


def test_carriers_refuse_what_they_cannot_carry(sphere, bump):
    with pytest.raises(ValueError, match="method='clone' is unknown"):
        UnitCarrier(sphere, sphere, "clone")
    with pytest.raises(ValueError, match=r"source has 642 vertices.*triangles differ"):
        UnitCarrier(sphere, sphere_mesh(2))
    with pytest.raises(ValueError, match="reach=0"):
        UnitCarrier(sphere, sphere, reach=0)
    with pytest.raises(ValueError, match="displacements has shape"):
        UnitCarrier(sphere, sphere).carry(bump[:, :-1])
    with pytest.raises(ValueError, match="displacements holds 1 value"):
        bump[0, 0, 0] = np.nan
        UnitCarrier(sphere, sphere).carry(bump)


def test_the_space_refuses_what_is_no_rig_or_no_mesh(actors):
    rig = actors["M1"].linear()
    with pytest.raises(TypeError, match=r"source is a .*BlendshapeRig.*linear"):
        IntermediateSpace(actors["M1"], rig.neutral)
    with pytest.raises(TypeError, match=r"target is a ndarray.*TriangleMesh"):
        IntermediateSpace(rig, rig.neutral.vertices)
    with pytest.raises(TypeError, match=r"target is a ndarray.*TriangleMesh"):
        UnitCarrier(rig.neutral, rig.neutral.vertices)
    with pytest.raises(TypeError, match=r"rig is a TriangleMesh.*BlendshapeRig"):
        SimplifiedRig(rig.neutral)


def test_a_target_of_another_topology_needs_landmarks_and_registration(actors):
    rig = actors["M1"].linear()
    with pytest.raises(ValueError, match="the scan's landmarks share 0"):
        IntermediateSpace(rig, sphere_mesh(3, radius=90))
    with pytest.raises(ValueError, match="register=False, but target has other triangles"):
        IntermediateSpace(rig, sphere_mesh(3, radius=90), register=False)


def test_a_sketch_of_another_size_or_with_nan_is_refused(space):
    with pytest.raises(ValueError, match=r"sketch has shape \(10, 3\).*another topology"):
        space.to_template(np.zeros((10, 3)))
    with pytest.raises(ValueError, match="the scan's landmarks share 0"):
        space.to_template(sphere_mesh(3, radius=90))
    with pytest.raises(TypeError, match=r"sketch is a str.*\(n_vertices, 3\)"):
        space.to_template("abc")
    V = space.target.vertices.copy()
    V[7, 1] = np.nan
    with pytest.raises(ValueError, match="sketch holds 1 value"):
        space.to_template(V)
    with pytest.raises(ValueError, match="vertices holds 1 value"):
        space.to_target(V)
    with pytest.raises(ValueError, match="vertices has shape"):
        space.to_target(V[:5])


def test_what_is_brought_to_life_is_checked(space):
    with pytest.raises(ValueError, match=r"unknown shape.*AU99"):
        space.bring_to_life({"AU99": 1.0})
    with pytest.raises(ValueError, match="weights has shape"):
        space.bring_to_life([1.0, 2.0])
    with pytest.raises(ValueError, match=r"n_frames=2, but .* must be 3 or more"):
        space.bring_to_life({"AU4": 1.0}, n_frames=2)
    with pytest.raises(ValueError, match="n_frames=-1, but the number of frames"):
        space.bring_to_life({"AU4": 1.0}, n_frames=-1)
    with pytest.raises(TypeError, match="n_frames='x' is not an integer"):
        space.bring_to_life({"AU4": 1.0}, n_frames="x")
    with pytest.raises(ValueError, match=r"unit_sequence.*has shape"):
        space.bring_to_life({"AU4": 1.0}, lambda name, n: np.zeros((n, 1, 3)))
