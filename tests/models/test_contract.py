"""What an estimator promises beyond its mathematics: nothing lost, nothing let in."""

import subprocess
import sys

import numpy as np
import pytest
from planted import corner_regions, three_strips

from facelab.models.components import row_blocks
from facelab.models.global_local import GlobalLocalModel
from facelab.models.holistic import HolisticModel
from facelab.models.region import N_COMPONENTS, RegionModel
from facelab.motion import MotionSequence


def learned(model):
    """All that a model has learned, to be compared."""
    return {k: v for k, v in vars(model).items() if k.endswith("_")}


# --- a refused fit --------------------------------------------------------------------------------


def stopped():
    """Blocks of another width, at whose second block somebody stops it."""
    yield np.zeros((5, 126))
    raise KeyboardInterrupt


def as_motion(X):
    return MotionSequence(X.reshape(-1, 42, 3), 30, corner_regions().mesh)


REFUSED = {
    "another width": lambda m, X: m.fit(X[:, :-3]),
    "one frame": lambda m, X: m.fit(X[:1]),
    "few frames": lambda m, X: m.set_params(n_components=30).fit(X[:4]),
    "lost frames": lambda m, X: m.fit(np.where(X > 1, np.nan, X)),
    "hidden values": lambda m, X: m.fit(np.ma.masked_greater(X, 1)),
    "text": lambda m, X: m.fit(X.astype(str).astype(object) + "x"),
    "a sequence": lambda m, X: m.fit(
        MotionSequence(X.reshape(-1, 42, 3), 30, corner_regions().mesh)
    ),
    "other regions": lambda m, X: m.set_params(regions=three_strips()).fit(X),
    "blocks of another width": lambda m, X: m.fit_blocks([X, X[:, :-3]], progress=False),
    "blocks that end": lambda m, X: m.fit_blocks(stopped, progress=False),
    "a setting": lambda m, X: m.set_params(spread="wide").fit(X),
}


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("kind", ["region", "holistic", "between"])
def test_a_refused_fit_changes_nothing_that_a_model_knows(rng, kind, name):
    if kind == "holistic" and name in ("another width", "other regions", "a setting"):
        pytest.skip("the whole face as one region takes any width and has no such setting")
    if kind == "between" and name in ("other regions", "a setting"):
        pytest.skip("it has no such setting")
    X = rng.normal(size=(40, 126))
    kinds = {"region": RegionModel, "between": GlobalLocalModel}
    model = kinds[kind](corner_regions(), 4) if kind in kinds else HolisticModel(4)
    model.fit(X)
    before = learned(model)
    assert {"mean_", "members_", "n_features_in_"} <= before.keys()
    with pytest.raises((ValueError, TypeError, KeyboardInterrupt)):
        REFUSED[name](model, X)
    after = learned(model)
    assert after.keys() == before.keys()
    for k in before:
        assert after[k] is before[k], f"{k} is another one"


def test_a_new_fit_forgets_the_names_of_old_columns_and_what_was_given(rng):
    pandas = pytest.importorskip("pandas")
    X = rng.normal(size=(20, 9))
    model = HolisticModel(2).fit(pandas.DataFrame(X, columns=[f"x{i}" for i in range(9)]))
    assert len(model.feature_names_in_) == 9
    model.fit_blocks([X], progress=False)
    assert not hasattr(model, "feature_names_in_")
    given = RegionModel.from_bases(None, np.zeros(9), [X[:2]])
    assert not hasattr(given.set_params(n_components=2).fit(X), "units_")


# --- how many modes where nothing is said ---------------------------------------------------------


@pytest.mark.parametrize(("n_frames", "width", "modes"), [(100, 126, 30), (8, 126, 7), (100, 9, 9)])
def test_thirty_modes_are_kept_or_as_many_as_there_are(rng, n_frames, width, modes):
    X = rng.normal(size=(n_frames, width))
    assert N_COMPONENTS == 30
    assert HolisticModel().fit(X).n_components_.tolist() == [modes]
    blocks = HolisticModel().fit_blocks(np.array_split(X, 3), progress=False)
    assert blocks.n_components_.tolist() == [modes]
    asked = HolisticModel(30)
    if modes < 30:  # what was asked for is given or refused
        with pytest.raises(ValueError, match=f"n_components=30.* allow 1 to {modes}"):
            asked.fit(X)
    else:
        assert asked.fit(X).n_coefficients == 30


def test_all_regions_together_keep_thirty_modes_where_nothing_is_said(rng):
    regions = corner_regions()
    X = rng.normal(size=(100, 126))
    assert RegionModel(regions, spread="total").fit(X).n_coefficients == 30
    assert RegionModel(regions, spread="total").fit(X[:4]).n_coefficients == 12
    each = RegionModel(regions).fit(X)
    assert each.n_components_.tolist() == [min(30, len(c)) for c in each.columns_]
    assert each.truncated(None).n_coefficients == each.n_coefficients


# --- values that are none -------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_coefficients_that_are_not_finite_are_refused(rng, bad):
    model = HolisticModel(3).fit(rng.normal(size=(10, 9)))
    Z = np.zeros((4, 3))
    Z[2, 1] = bad
    with pytest.raises(ValueError, match=r"Z holds 1 value.*index \(2, 1\)"):
        model.inverse_transform(Z)


def test_the_mask_of_an_array_is_not_lost(rng):
    X = rng.normal(size=(10, 9))
    model = HolisticModel(3).fit(X)
    hidden = np.ma.array(X, mask=X > 1.5)
    n = int((X > 1.5).sum())
    for action in (model.fit, model.transform, model.reconstruct):
        with pytest.raises(ValueError, match=f"X is a masked array that hides {n} value"):
            action(hidden)
    with pytest.raises(ValueError, match="hides 1 value"):
        model.inverse_transform(np.ma.array(np.zeros((1, 3)), mask=[[0, 1, 0]]))
    with pytest.raises(ValueError, match=f"hides {n} value"):
        model.fit_blocks([hidden], progress=False)
    with pytest.raises(ValueError, match="hides"):
        model.fit_blocks([np.ma.array(X, dtype=np.float32, mask=X > 1.5)], progress=False)
    with pytest.raises(ValueError, match="mean is a masked array"):
        RegionModel.from_bases(None, hidden[:1], [X[:1]])
    with pytest.raises(ValueError, match="bases is a masked array"):
        RegionModel.from_bases(None, X[0], hidden)
    bare = np.ma.array(X)  # hides nothing
    np.testing.assert_array_equal(model.transform(bare), model.transform(X))


# --- frames on disk -------------------------------------------------------------------------------


@pytest.fixture
def stored(tmp_path, rng):
    """Frames in a file, some blocks long."""

    def store(X, dtype=np.float32):
        frames = np.lib.format.open_memmap(tmp_path / "X.npy", "w+", dtype, X.shape)
        frames[:] = X
        frames.flush()
        return np.load(tmp_path / "X.npy", mmap_mode="r")

    return store


@pytest.mark.parametrize("dtype", [np.float32, float, np.int16])
def test_coefficients_of_frames_on_disk_are_those_of_frames_in_memory(
    rng, stored, dtype, monkeypatch
):
    monkeypatch.setattr("facelab.models.components.BLOCK_BYTES", 8 * 126 * 7)
    X = (10 * rng.normal(size=(40, 126))).astype(dtype)
    model = RegionModel(corner_regions(), 4).fit(X)
    frames = stored(X, dtype)
    assert sum(1 for _ in row_blocks(frames)) == 6
    np.testing.assert_allclose(model.transform(frames), model.transform(X.astype(float)), atol=1e-5)
    for cut in (frames[::2], frames[3:4]):
        np.testing.assert_allclose(model.transform(cut), model.transform(np.array(cut)), atol=1e-9)
    with pytest.raises(ValueError, match="123 features, but RegionModel is expecting 126"):
        model.transform(frames[:, :-3])


def test_lost_frames_on_disk_are_refused_with_their_place(rng, stored, monkeypatch):
    monkeypatch.setattr("facelab.models.components.BLOCK_BYTES", 8 * 9 * 7)
    X = rng.normal(size=(40, 9))
    model = HolisticModel(3).fit(X)
    X[30, 2] = np.nan
    with pytest.raises(ValueError, match=r"X in frames 28 to 34 holds 1 .* index \(2, 2\)"):
        model.transform(stored(X))


PEAK = """
import resource, sys
import numpy as np
from facelab.models.global_local import GlobalLocalModel
from facelab.models.holistic import HolisticModel
rng = np.random.default_rng(0)
model = HolisticModel(5).fit(rng.normal(size=(20, 3000)))
frames = np.load(sys.argv[1], mmap_mode="r")
model.transform(frames[:10])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
model.transform(frames)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss counts otherwise elsewhere")
def test_frames_on_disk_are_never_in_memory_as_a_whole(tmp_path):
    frames = np.lib.format.open_memmap(tmp_path / "X.npy", "w+", np.float32, (15_000, 3000))
    frames[:] = 1.0
    frames.flush()
    size = frames.nbytes / 2**20
    del frames
    command = [sys.executable, "-c", PEAK, str(tmp_path / "X.npy")]
    said = subprocess.run(command, capture_output=True, text=True, check=True)
    # blocks of 16 MiB in float64, a few copies of one at a time; once it took 4.7 times the file
    assert float(said.stdout) < 100 < size
