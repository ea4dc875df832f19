"""The posing lab on a rig of one's own."""

from pathlib import Path

import numpy as np
import pytest
from planted import bumpy_rig

from facelab.data import load_example
from facelab.files import read_rig, write_glb
from facelab.geometry.mesh import TriangleMesh
from facelab.motion import WeightSequence
from facelab.rig import BlendshapeRig
from facelab.widgets import PosingLab
from facelab.widgets.own_face import shown_parts

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"
pytestmark = pytest.mark.filterwarnings("ignore:.*longest side is")


@pytest.fixture
def in_pieces():
    """A face with a ball beside it that no shape moves, in one mesh."""
    rig = bumpy_rig()
    V, F, n = rig.neutral.vertices, rig.neutral.faces, rig.neutral.n_vertices
    both = TriangleMesh(np.vstack([V, V / 4 + 100]), np.vstack([F, F + n]))
    return BlendshapeRig(both, rig.names, np.hstack([rig.deltas, 0 * rig.deltas]))


def test_a_file_opens_as_a_rig_and_as_regions_with_its_other_parts():
    lab = PosingLab.open(FIXTURES / "avatar.glb", n_regions=4)
    assert list(lab.models) == ["region", "rig"] and len(lab.props) == 2
    assert "plausible mixtures" in lab.about and "avatar.glb: 4 shapes" in lab.about
    assert lab.about in lab._status.value


def test_a_take_is_learned_from_and_can_be_played():
    rig = read_rig(FIXTURES / "avatar.glb")
    rng = np.random.default_rng(0)
    take = WeightSequence(rng.uniform(0, 1, (90, 2)), ["JawOpen", "eyeBlink_L"], 30)
    lab = PosingLab.open(rig, take, n_regions=4)
    assert "learned from the take" in lab.about and list(lab.takes) == ["take"]


def test_of_a_head_in_pieces_the_one_that_moves_is_posed(in_pieces):
    lab = PosingLab.open(in_pieces, n_regions=4)
    n = in_pieces.neutral.n_vertices // 2
    assert lab.session.neutral.n_vertices == n
    assert [mesh.n_vertices for mesh, _ in lab.props] == [n]
    assert "in 2 pieces, of which the largest that moves is posed" in lab.about


def test_teeth_of_the_file_go_with_the_jaw_in_both_models_and_still_parts_stay():
    rig = read_rig(FIXTURES / "avatar.glb")
    lab = PosingLab.open(rig, n_regions=4)
    teeth, eye = (dict(zip(rig.parts, lab.props, strict=True))[n] for n in ("Teeth", "EyeLeft"))
    rest, opens = rig.neutral.vertices, rig.deltas[rig.names.index("jawOpen")]
    (moves,) = rig.parts["Teeth"].deltas
    assert np.abs(moves).max() > 5, "they go far"
    np.testing.assert_array_equal(teeth.move(rest), teeth.mesh.vertices)
    for share in (0.4, 1.0):
        gone = teeth.move(rest + share * opens) - teeth.mesh.vertices
        np.testing.assert_allclose(gone, share * moves, atol=0.01 * np.abs(moves).max())
    smile = rig.deltas[rig.names.index("mouthSmileRight")]
    gone = teeth.move(rest + smile) - teeth.mesh.vertices
    assert np.abs(gone).max() < 0.05 * np.abs(moves).max()
    assert eye.move is None


def test_of_a_head_in_one_mesh_the_other_pieces_go_as_its_shapes_move_them(in_pieces):
    n = in_pieces.neutral.n_vertices // 2
    deltas = in_pieces.deltas.copy()
    deltas[0, n:] = [0, -9, 3]
    lab = PosingLab.open(BlendshapeRig(in_pieces.neutral, in_pieces.names, deltas), n_regions=4)
    (ball,) = lab.props
    pose = in_pieces.neutral.vertices[:n] + 0.5 * deltas[0, :n]
    gone = ball.move(pose) - ball.mesh.vertices
    np.testing.assert_allclose(gone, np.tile([0, -4.5, 1.5], (n, 1)), atol=0.1)


def test_another_rig_takes_the_place_of_the_first_in_the_same_page(tmp_path):
    rig = bumpy_rig()
    write_glb(tmp_path / "head.glb", rig.neutral, rig.deltas, rig.names)
    lab = PosingLab.open(FIXTURES / "avatar.glb", n_regions=4)
    page, before = lab.widget, lab.session
    lab.become(read_rig(tmp_path / "head.glb", scale=1000))
    assert lab.widget is page and lab.session is not before
    assert lab.session.neutral.n_vertices == rig.neutral.n_vertices
    shown = lab.vertices.copy()
    before.mold(0, 0, 0.5)  # a script still holds the old one
    np.testing.assert_array_equal(lab.vertices, shown)
    assert lab._follow not in [known() for known in before.history._observers]


def test_a_file_that_is_no_rig_leaves_the_lab_as_it_was(tmp_path):
    (tmp_path / "bad.glb").write_bytes(b"glTF")
    lab = PosingLab.open(FIXTURES / "avatar.glb", n_regions=4)
    session = lab.session
    with pytest.raises(ValueError, match=r"bad\.glb"):
        lab.become(tmp_path / "bad.glb")
    assert lab.session is session


def test_a_head_without_landmarks_or_parts_gets_eyes_and_teeth_where_its_shapes_tell_of_them():
    rig = load_example().rig
    bare = TriangleMesh(rig.neutral.vertices, rig.neutral.faces)
    shown = shown_parts(BlendshapeRig(bare, rig.names, rig.deltas), {})
    assert [prop.name for prop in shown[:3]] == ["eye_left", "eye_right", "teeth_upper"]
    off = {"eye_left": 1, "eye_right": -1}  # the side, head frame
    assert all(off[prop.name] * prop.mesh.vertices[:, 0].mean() > 15 for prop in shown[:2])
    named = BlendshapeRig(bare, [f"shape {k}" for k in range(2)], rig.deltas[:2])
    assert shown_parts(named, {}) == []
