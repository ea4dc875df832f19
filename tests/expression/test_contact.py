"""Lips held off each other: planted sheets that cross by a known depth, and carried faces."""

from itertools import pairwise

import numpy as np
import pytest

from data_synth.action_units import actor_rig
from facelab.expression import contact as module
from facelab.expression.contact import Contact, Slit
from facelab.expression.transfer import IntermediateSpace
from facelab.geometry.crossings import cutting
from facelab.geometry.mesh import TriangleMesh

X, ALONG = np.meshgrid(np.linspace(-25, 25, 26), np.linspace(0, np.pi, 13), indexing="ij")
HALF = X.size
MIDDLE = int(np.argmin(X.ravel() ** 2 + (ALONG.ravel() - np.pi / 2) ** 2))

SHIFT = np.array([0.7, 0.0, 0.3])  # else edges would lie on edges, which is no cut


def lips(gap):
    """Two half pipes of 6 mm, one over the other, so far apart at rest."""
    z, y = 6 * np.cos(ALONG), 6 - 6 * np.sin(ALONG) + gap / 2
    upper = np.stack([X, y, z], axis=-1).reshape(-1, 3)
    k = np.arange(HALF).reshape(X.shape)
    a, b, c, d = (m.ravel() for m in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    F = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    mesh = TriangleMesh(
        np.concatenate([upper, upper * [1, -1, 1] + SHIFT]), np.concatenate([F, F[:, ::-1] + HALF])
    )
    if mesh.normals[MIDDLE, 1] > 0:  # outwards is down for the upper lip
        mesh = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    return mesh


def slit(mesh):
    return Slit(mesh, [MIDDLE], [MIDDLE + HALF], (90.0, 8.0))


def pressed(mesh, depth):
    """Each lip nearer to the other by half of `depth` in the middle."""
    V = mesh.vertices.copy()
    way = depth / 2 * np.exp(-((V[:, 0] / 12) ** 2))
    V[:, 1] -= np.where(np.arange(len(V)) < HALF, way, -way)
    return V


@pytest.mark.parametrize("depth", [0.2, 1.0, 2.0])
def test_two_lips_that_cross_by_a_known_depth_are_parted_by_it_and_both_give_way(depth):
    mesh = lips(0.4)
    found, V = slit(mesh), pressed(mesh, 0.4 + depth)
    assert found.crossings(V[found.skin])
    push = found.push(V)
    after = V.copy()
    after[found.skin] += push
    assert not found.crossings(after[found.skin]) and not found.folds(after[found.skin])
    up, down = after[[MIDDLE, MIDDLE + HALF], 1] - V[[MIDDLE, MIDDLE + HALF], 1]
    assert 0.95 * depth < up - down < depth + 0.3
    assert up == pytest.approx(-down, rel=0.05)


def test_what_is_pushed_bends_little_and_far_skin_stays():
    mesh = lips(0.4)
    found, V = slit(mesh), pressed(mesh, 1.4)
    push = np.zeros_like(V)
    push[found.skin] = found.push(V)
    a, b = mesh.edges.T
    strain = np.linalg.norm(push[a] - push[b], axis=1) / np.linalg.norm(
        mesh.vertices[a] - mesh.vertices[b], axis=1
    )
    assert strain.max() < 0.25
    assert np.linalg.norm(push[np.abs(V[:, 0]) > 24], axis=1).max() < 0.1


def test_lips_that_do_not_cross_are_not_touched():
    mesh = lips(0.4)
    assert slit(mesh).push(pressed(mesh, 0.3)) is None
    assert slit(mesh).push(pressed(mesh, -8.0)) is None


def test_what_overlaps_at_rest_may_overlap_so_and_no_more():
    mesh = lips(-0.5)
    found = slit(mesh)
    assert found.push(mesh.vertices) is None
    V = pressed(mesh, 1.0)
    V[found.skin] += found.push(V)
    gap = V[MIDDLE, 1] - V[MIDDLE + HALF, 1]
    assert -0.55 < gap < -0.2
    assert found._cut(V[found.skin]).size and not found.crossings(V[found.skin] + found.overlap)


def test_a_push_that_would_fold_a_lip_is_not_taken(monkeypatch):
    mesh = lips(0.4)
    found, V = slit(mesh), pressed(mesh, 1.4)
    monkeypatch.setattr(Slit, "folds", lambda self, Y: set() if Y is first else {(0, 1, 2)})
    first = V[found.skin]
    assert found._parted(first, 0, 3) is None


@pytest.fixture(scope="module")
def carried():
    rigs = [actor_rig(name, 3000).linear() for name in ("M1", "F1")]
    space = IntermediateSpace(rigs[0], rigs[1].neutral, contact=True)
    rng = np.random.default_rng(3)
    faces = []
    for _ in range(6):
        W = np.zeros(len(rigs[0].names))
        W[rng.choice(len(W), 5, replace=False)] = rng.uniform(0.5, 1, 5)
        faces.append(space.rig.neutral.vertices + np.tensordot(W, space.rig.deltas, axes=1))
    faces.append(space.rig.shape({"AU24": 1, "AU28": 1}))
    return space, faces


def test_lips_of_carried_faces_cross_less_and_no_sheet_folds_more(carried):
    space, faces = carried
    contact, before, after = Contact(space.target), 0, 0
    for V in faces:
        there = space.to_target(V)
        was, now = contact.counts(V), contact.counts(there)
        for name in was:
            assert now[name][0] <= was[name][0] and now[name][2] <= was[name][2]
            before, after = before + was[name][0], after + now[name][0]
        if not any(more for more, *_ in was.values()):
            np.testing.assert_array_equal(there, V)
        np.testing.assert_array_equal(space.to_target(V), there)  # the same each time
    assert before > 50 and after < 0.2 * before


def test_lips_wound_inwards_are_held_off_each_other_alike(carried):
    space, poses = carried
    mesh = space.target
    low = mesh.vertices[mesh.faces].mean(axis=1)[:, 1:2] < -60
    faces = np.where(low, mesh.faces[:, ::-1], mesh.faces)
    with pytest.warns(UserWarning, match=r"mesh: .* wound inwards"):
        wrong = Contact(TriangleMesh(mesh.vertices, faces, mesh.landmarks))
    here, there = (contact.off(poses[-1]) for contact in (Contact(mesh), wrong))
    np.testing.assert_allclose(there, here, atol=1e-9)
    assert (here != poses[-1]).any()


def test_lips_are_known_by_landmarks_in_any_spelling(carried):
    mesh = carried[0].target
    marks = {n.upper(): v for n, v in mesh.landmarks.items()}
    assert set(Contact(TriangleMesh(mesh.vertices, mesh.faces, marks)).slits) == set(
        Contact(mesh).slits
    )


def test_contact_is_off_unless_asked_for(carried):
    space, faces = carried
    plain = IntermediateSpace(space.source, space.target)
    moved = [np.abs(space.to_target(V) - V).max() for V in faces]
    assert max(moved) > 0.05
    for V in faces:
        np.testing.assert_array_equal(plain.to_target(V), V)
    with pytest.raises(ValueError, match="contact"):
        IntermediateSpace(space.source, space.target, contact="lips")


def test_a_face_at_rest_and_a_face_without_landmarks_come_back_themselves(carried):
    face = carried[0].target
    V = face.vertices
    assert Contact(face).off(V) is V
    bare = Contact(TriangleMesh(V, face.faces))
    pose = carried[1][-1]
    assert not bare.slits and bare.off(pose) is pose


def test_the_two_sides_of_a_seam_stay_together(carried):
    face, pose = carried[0].target, carried[1][-1]
    plain = Contact(face).off(pose)
    n, own = face.n_vertices, np.flatnonzero(face.vertices[:, 0] > 0)
    new = np.arange(n)
    new[own] = n + np.arange(len(own))
    F = face.faces.copy()
    right = (face.vertices[F][..., 0].mean(axis=1)) > 0
    F[right] = new[F[right]]
    kept, F = np.unique(F, return_inverse=True)
    back = np.concatenate([np.arange(n), own])[kept]
    split = TriangleMesh(
        face.vertices[back], F.reshape(-1, 3),
        {k: int(np.flatnonzero(back == v)[0]) for k, v in face.landmarks.items()},
    )  # fmt: skip
    np.testing.assert_allclose(Contact(split).off(pose[back]), plain[back], atol=0.02)


def test_contact_refuses_what_it_cannot_hold(carried, monkeypatch):
    face = carried[0].target
    with pytest.raises(ValueError, match="vertices"):
        Contact(face).off(face.vertices[:5])
    monkeypatch.setattr(module, "_MOST", 50)
    with pytest.raises(ValueError, match="thin it"):
        Contact(face)


def test_triangles_that_cut_are_those_of_a_plain_search(rng):
    V = rng.normal(size=(60, 3))
    F = np.array([rng.choice(60, 3, replace=False) for _ in range(40)])

    def meets(one, two):
        for s, t in ((one, two), (two, one)):
            a, b, c = V[t]
            for p, q in pairwise([*s, s[0]]):
                if {p, q} & set(t):
                    continue
                x = np.linalg.solve(np.stack([V[q] - V[p], a - b, a - c], axis=1), a - V[p])
                if 0 < x[0] < 1 and x[1] > 0 and x[2] > 0 and x[1] + x[2] < 1:
                    return len(set(s) & set(t)) < 2
        return False

    slow = {(i, j) for i in range(15) for j in range(25) if meets(F[i], F[15 + j])}
    assert set(map(tuple, cutting(V, F[:15], F[15:]).tolist())) == slow and slow
    inside = {(i, j) for i in range(40) for j in range(i + 1, 40) if meets(F[i], F[j])}
    assert set(map(tuple, cutting(V, F).tolist())) == inside
