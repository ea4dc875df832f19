import numpy as np
import pytest
from shapes import sphere_mesh

from facelab.data import TAKES, DataUnavailable, load_aura, load_aura_take, load_take
from facelab.data.aura import AURA_UNITS
from facelab.motion import WeightSequence
from facelab.rig import BlendshapeRig
from facelab.studies import translation


@pytest.fixture(scope="module")
def pair():
    mesh = sphere_mesh(2, radius=100.0)
    rng = np.random.default_rng(0)
    rig = BlendshapeRig(mesh, ["a_L", "a_R", "b"], 20 * rng.normal(size=(3, mesh.n_vertices, 3)))
    both = np.stack([rig.deltas[0] + rig.deltas[1], rig.deltas[2]])
    return translation.both_ways(rig, BlendshapeRig(mesh, ["A", "B"], both))


TABLE = {"a_L": ("A",), "a_R": ("A",), "b": ("B",)}


def take(rows):
    return WeightSequence(rows, ("a_L", "a_R", "b"), 30)


def test_what_both_rigs_can_make_comes_back_whole_in_every_way(pair):
    w = np.repeat(np.random.default_rng(1).uniform(0, 1, (10, 2)), [2, 1], axis=1)
    for way in ("nearest", "map", "names"):
        found = translation.trip(*pair, take(w), way, TABLE)
        assert found.left < 0.02 * found.moves, way
        assert found.lost < 0.02 and found.off < 0.02, way


def test_what_is_lost_is_counted_by_hand(pair):
    w = np.array([[1.0, 0, 0]])
    found = translation.trip(*pair, take(w), "names", TABLE)  # comes back on both sides
    d = pair[0].rig.deltas
    size = np.linalg.norm(d, axis=2)
    assert found.moves == pytest.approx(np.sqrt((size[0] ** 2).mean()))
    extra = pytest.approx(np.sqrt((size[1] ** 2).mean()))
    assert found.left == extra and found.lost * found.moves == extra
    assert found.off == pytest.approx(1) and found.active == 1


def test_a_table_is_printed_with_a_line_for_each_way(pair):
    text = translation.table(*pair, take(np.eye(3)), TABLE)
    assert [line.split()[0] for line in text.splitlines()] == ["way", "nearest", "map", "names"]


def test_the_table_of_aura_names_units_that_there_are():
    assert set(translation.AURA_BY_NAME) <= set(AURA_UNITS)
    back = translation.turned(translation.AURA_BY_NAME)
    assert back["mouthFunnel"] == tuple(f"lipFunneler_{q}" for q in ("LB", "LT", "RB", "RT"))


@pytest.mark.real
def test_the_table_of_aura_names_shapes_of_the_generic_face(real_rig):
    assert {n for found in translation.AURA_BY_NAME.values() for n in found} <= set(real_rig.names)


@pytest.mark.real
def test_takes_come_back_with_their_weights(real_rig):
    try:
        aura, own = load_aura(), load_aura_take()
        takes = {name: load_take(name) for name in TAKES}
    except DataUnavailable as missing:
        pytest.skip(str(missing))
    there, back = translation.both_ways(real_rig, aura)
    trips = [translation.trip(there, back, take) for take in takes.values()]
    trips.append(translation.trip(back, there, own))
    for trip in trips:
        assert trip.off < 1 / 3 and trip.lost < 0.1, trip
