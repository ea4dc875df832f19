import numpy as np
import pytest

import facelab
from facelab.data.registered import load_registered


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Registered afresh, from the captures that are kept."""
    captures = facelab.data.cache_dir()
    folder = tmp_path_factory.mktemp("cache")
    facelab.data.load_capture("F1", size="small", progress=False)
    (folder / "data_synth-small-0").symlink_to(captures / "data_synth-small-0")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FACELAB_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="module")
def actor(cache):
    return load_registered("F1", size="small", progress=False)


def rms(moved):
    return np.sqrt((moved**2).sum(axis=-1).mean())


def test_registered_motion_is_near_the_true_skin(actor):
    found, true = (
        m.displacements().reshape(m.n_frames, -1, 3) for m in (actor.motion(), actor.truth())
    )
    assert rms(found - true) < 0.6 < 0.5 * rms(true)


def test_every_actor_has_the_same_samples(actor):
    other = load_registered("M1", size="small", progress=False)
    np.testing.assert_array_equal(actor.samples, other.samples)
    np.testing.assert_array_equal(actor.mesh.faces, other.mesh.faces)
    assert not np.allclose(actor.mesh.vertices, other.mesh.vertices)


def test_kept_motion_is_that_of_the_dense_frames(actor):
    take = actor.takes["test"][0]
    registration = actor.registration(take)
    step = round(registration.fps / actor.fps)
    dense = registration.positions(slice(None, None, step))
    np.testing.assert_allclose(actor.motion(take).positions, dense[:, actor.samples], atol=1e-4)


def test_takes_are_asked_for_by_kind_by_name_or_all_at_once(actor):
    some = [actor.motion(kind).n_frames for kind in ("train", "test")]
    assert sum(some) == actor.motion().n_frames == actor.truth().n_frames
    train, test = actor.takes["train"], actor.takes["test"]
    joined = actor.motion([*test, train[0]])
    np.testing.assert_array_equal(joined.positions[: some[1]], actor.motion("test").positions)
    assert joined.n_frames == some[1] + actor.motion(train[0]).n_frames


def test_a_second_call_gives_the_same_and_a_damaged_file_is_made_again(actor, cache):
    (kept,) = (cache / "registered").glob("F1-*/arrays.npz")
    again = load_registered("F1", size="small", progress=False)
    np.testing.assert_array_equal(again.motion().positions, actor.motion().positions)
    np.testing.assert_array_equal(again.fit.mesh.vertices, actor.fit.mesh.vertices)
    assert list(again.fit.steps) == list(actor.fit.steps) and again.fit.rms == actor.fit.rms
    kept.write_bytes(kept.read_bytes()[:1000])
    again = load_registered("F1", size="small", progress=False)
    np.testing.assert_array_equal(again.motion().positions, actor.motion().positions)


def test_a_model_of_one_actor_is_as_wide_as_the_motion_of_another(actor):
    X = actor.motion("train").displacements()
    assert X.shape == (actor.motion("train").n_frames, 3 * 397)
    assert np.isfinite(X).all()


@pytest.mark.parametrize("takes", ["trian", ["rage_1", "rage_9"], [], "rom"])
def test_takes_that_are_not_there_are_named(actor, takes):
    with pytest.raises(ValueError, match=r"takes names .* but F1 has the kinds train, test"):
        actor.motion(takes)


def test_a_rate_that_does_not_divide_the_captures_is_refused(cache):
    with pytest.raises(ValueError, match="fps=25 does not divide the 60 frames"):
        load_registered("F1", size="small", fps=25, progress=False)
    with pytest.raises(ValueError, match="fps"):
        load_registered("F1", size="small", fps=0, progress=False)


def test_errors_are_those_of_the_skin_and_nothing_where_the_truth_is_put_in(actor):
    take = actor.takes["test"][0]
    registration = actor.registration(take)
    error = actor.errors(registration, take, [10, 40])
    assert error.shape == (2, actor.fit.mesh.n_vertices)
    small = actor.motion(take).displacements() - actor.truth(take).displacements()
    step = round(registration.fps / actor.fps)
    small = np.linalg.norm(small.reshape(len(small), -1, 3), axis=2)
    np.testing.assert_allclose(
        actor.errors(registration, take, slice(None, None, step))[:, actor.samples],
        small,
        atol=1e-3,
    )
    assert error[:, actor.covered].mean() < error[:, ~actor.covered].mean()
