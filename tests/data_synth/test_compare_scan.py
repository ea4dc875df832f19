"""Comparison with a scan, on faces whose distance is known."""

import numpy as np
from scipy.spatial.transform import Rotation

from data_synth.action_units import actor_rig
from data_synth.compare_scan import distances


def test_a_face_lies_on_itself_however_it_is_turned_and_scaled():
    face = actor_rig("F1", 3000).neutral
    turn = Rotation.from_rotvec([0.3, -0.6, 0.2])
    other = face.with_vertices(1.3 * turn.apply(face.vertices.copy()) + [10, 2, -5])
    assert distances(face, other).max() < 1e-9


def test_a_bump_is_found_where_it_is_and_as_high_as_it_is():
    face = actor_rig("F1", 3000).neutral
    V = face.vertices.copy()
    cheek = np.argmin(np.linalg.norm(V - (V[face.landmarks["nose_tip"]] + [45, -5, -30]), axis=1))
    assert cheek not in face.landmarks.values()
    V[cheek] += 6 * face.normals[cheek]
    found = distances(face.with_vertices(V), face)
    assert found.argmax() == cheek
    assert 5.0 < found[cheek] < 6.05
    assert np.delete(found, cheek).max() < 1e-9
