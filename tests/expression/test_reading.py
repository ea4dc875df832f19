"""The few units of a rough sketch: planted mixtures, twists, another's manner."""

import numpy as np
import pytest
from planted import bumpy_rig

from facelab.expression import ExpressionSession, find_units, prepare_units, regress_expression
from facelab.expression.reading import FINEST, OUTLIER
from facelab.expression.units import UnitBasis
from facelab.rig import BlendshapeRig
from facelab.studies.expression_trials import draw_mixtures, score, spoil


@pytest.fixture(scope="module")
def actor():
    from data_synth.action_units import actor_rig

    return actor_rig("M1", 2000).linear()


@pytest.fixture(scope="module")
def basis(actor):
    return prepare_units(actor)


def read_all(basis, W, noise, twist, seed):
    rig = basis.rig
    rough = [spoil(rig.neutral, rig.shape(w), noise, twist, random_state=seed + i)
             for i, w in enumerate(W)]  # fmt: skip
    few = np.array([find_units(basis, V, align=False).weights for V in rough])
    plain = np.array([regress_expression(basis, V, 0, [0], align=False).weights[0] for V in rough])
    return score(W, few), score(W, plain)


@pytest.mark.parametrize(("noise", "twist"), [(0.5, 0), (0.5, 4), (1, 8)])
def test_units_of_rough_sketches_are_read_and_no_others(basis, noise, twist):
    W = draw_mixtures(40, 12, (1, 6), random_state=7)
    few, plain = read_all(basis, W, noise, twist, 500)
    assert few.precision > 0.9 and few.recall > 0.9 and few.error < plain.error
    assert few.precision > plain.precision + (0.2 if twist else 0)


def test_a_clean_mixture_is_read_exactly_strongest_mover_first(basis):
    planted = {"AU12L": 0.5, "AU4": 0.9, "AU38": 0.4}
    found = find_units(basis, basis.rig.shape(planted))
    assert found.units == pytest.approx(planted, abs=1e-4)
    moves = {n: w * np.sqrt((basis.rig.deltas[basis.rig.names.index(n)] ** 2).sum(1).mean())
             for n, w in planted.items()}  # fmt: skip
    assert list(found.units) == sorted(moves, key=moves.get, reverse=True)
    assert found.moves.max() == pytest.approx(max(moves.values()), rel=1e-3)
    assert found.rms < 1e-3 and found.noise < 1e-3 and found.misfit < 1e-3
    np.testing.assert_allclose(found.vertices, basis.rig.shape(planted), atol=1e-2)


def test_next_to_nothing_is_read_into_a_neutral_face_with_noise(basis, rng):
    """A threshold of log(n) variances: one false unit in some fifteen sketches of forty units."""
    V = basis.rig.neutral.vertices
    found = [find_units(basis, V + rng.normal(scale=0.5, size=V.shape)) for _ in range(8)]
    assert sum(len(f.units) for f in found) <= 2
    assert "UnitReading(no units)" in map(repr, found)
    for f in found:
        assert f.noise == pytest.approx(0.5, rel=0.2)  # the tails are trusted less


def test_patches_out_of_place_are_not_trusted_and_the_rest_is(basis):
    rig, planted = basis.rig, {"AU12L": 0.8}
    clean = rig.shape(planted)
    twisted = spoil(rig.neutral, clean, 0.1, 8, n_twists=3, random_state=3)
    pushed = np.linalg.norm(twisted - clean, axis=1)
    found = find_units(basis, twisted)
    assert (found.trust[pushed > 4] < 0.05).all() and np.median(found.trust[pushed < 0.2]) > 0.7
    assert found.units == pytest.approx(planted, abs=0.02)
    lost = 100 * np.mean(found.trust < 0.1)
    assert f"{lost:.0f} % of the vertices out of place" in found.report
    assert "0.10 mm of noise" in found.report or "0.09 mm of noise" in found.report


def test_what_neighbours_share_is_misfit_and_weighs_more_than_noise(basis):
    """A wave over the face, of the same size as a noise, is nothing that averages away."""
    rig, planted = basis.rig, {"AU12L": 0.5, "AU5": 0.3}
    V, clean = rig.neutral.vertices, rig.shape(planted)
    wave = 0.5 * np.sin(V[:, [1, 2, 0]] / 15)
    noise = np.random.default_rng(0).normal(scale=wave.std(), size=V.shape)
    smooth, rough = (find_units(basis, clean + e, align=False) for e in (wave, noise))
    assert smooth.misfit > 0.2 > 3 * rough.misfit and rough.noise > 3 * smooth.noise
    assert set(rough.units) == set(planted) and "AU5" not in smooth.units


def test_bounds_locks_and_exclusions_hold(basis):
    rig = basis.rig
    V = rig.shape({"AU12L": 0.8, "AU4": 0.5})
    found = find_units(basis, V, locked={"AU9": 0.3}, excluded=["AU4"])
    assert found.units["AU9"] == 0.3 and "AU4" not in found.units
    over = find_units(
        basis, rig.neutral.vertices + 1.5 * (rig.shape({"AU4": 1}) - rig.neutral.vertices)
    )
    assert over.units["AU4"] == 1.0
    minus = 2 * rig.neutral.vertices - rig.shape({"AU4": 0.5})
    assert find_units(basis, minus, bounds=None).units == pytest.approx({"AU4": -0.5}, abs=1e-4)
    assert find_units(basis, minus).units.get("AU4", 0) == 0
    with pytest.raises(ValueError, match="unknown unit"):
        find_units(basis, V, excluded=["AU99"])


def test_units_that_were_dropped_stay_at_nothing():
    rig = bumpy_rig()
    deltas = np.concatenate([rig.deltas, 1e-4 * rig.deltas[:1]])
    with pytest.warns(UserWarning, match="left out"):
        basis = prepare_units(BlendshapeRig(rig.neutral, (*rig.names, "still"), deltas))
    assert isinstance(basis, UnitBasis)
    found = find_units(basis, rig.shape({rig.names[2]: 0.7}))
    assert found.units == pytest.approx({rig.names[2]: 0.7}, abs=1e-3)
    assert found.names[-1] == "still" and found.weights[-1] == 0 and OUTLIER > FINEST


def test_a_session_keeps_what_is_found_in_one_step(basis):
    rig = basis.rig
    V = spoil(rig.neutral, rig.shape({"AU12L": 0.8, "AU4": 0.5}), 0.5, 4, random_state=1)
    session = ExpressionSession(basis, V)
    before = np.count_nonzero(session.weights > 0.01)
    found = session.keep_found()
    assert {"AU12L", "AU4"} <= set(found.units) == set(session.named)
    assert before > len(found.units)
    session.undo()
    assert np.count_nonzero(session.weights > 0.01) == before


@pytest.mark.real
def test_the_smirk_of_the_readme_is_read_as_a_smile_first(real_rig, real_takes):
    """A pose by regions is no mixture of the shapes: what is off is off as a whole."""
    from facelab import model_from_take

    face = model_from_take(real_takes["alex_rom_3"], real_rig, noise=0.3, progress=False)
    session = face.session()
    corner = face.neutral.landmarks["mouth_corner_left"]
    session.drag(corner, face.neutral.vertices[corner] + [4, 6, -2])
    found = find_units(real_rig, session.vertices)
    first = next(iter(found.units))
    assert first == "mouthSmile_L" and found.units[first] == max(found.units.values())
    assert len(found.units) <= 4
    plain = regress_expression(real_rig, session.vertices, 0, [0])
    assert plain.names[int(plain.weights[0].argmax())] == "mouthLowerDown_R"
