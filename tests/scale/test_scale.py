"""Two worker processes do what one machine does, and go on past what fails."""

import json
import os
import signal
import sys
import time

import numpy as np
import pytest
from planted import patch_motion, quarters
from shapes import grid_mesh

import facelab
from facelab import files, scale
from facelab.cli import main
from facelab.motion import MotionSequence
from facelab.segmentation import Regions, motion_correlation

pytest.importorskip("distributed", reason="needs Dask: pip install 'facelab[scale]'")
cloudpickle = pytest.importorskip("cloudpickle")
da = pytest.importorskip("dask.array")

EXACT = 1e-10  # relative: sums of some hundred products, taken in another order


@pytest.fixture(scope="module")
def client():
    cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers do not see the tests
    with scale.cluster(workers=2, memory=None) as client:
        yield client


@pytest.fixture(scope="module")
def moving():
    mesh, truth = quarters()
    return patch_motion(mesh, truth, np.random.default_rng(0)), Regions(truth, mesh)


def in_blocks(X):
    return da.from_array(np.asarray(X), chunks=(50, *(40 for _ in X.shape[1:])))


# --- learning -------------------------------------------------------------------------------------


def test_narrow_regions_learned_on_workers_are_those_of_one_machine(client, moving):
    motion, regions = moving
    X = motion.displacements()
    one = facelab.RegionModel(regions, 8).fit(X)
    many = facelab.RegionModel(regions, 8).fit(in_blocks(X))
    np.testing.assert_allclose(many.mean_, one.mean_, atol=EXACT * np.abs(X).max())
    for a, b, B in zip(one.variances_, many.variances_, many.components_, strict=True):
        np.testing.assert_allclose(a, b, rtol=EXACT)
        np.testing.assert_allclose(B @ B.T, np.eye(len(B)), atol=1e-12)
    np.testing.assert_allclose(many.reconstruct(X), one.reconstruct(X), atol=1e-6)


def test_a_share_of_the_variance_keeps_the_same_modes_on_workers(client, moving):
    motion, regions = moving
    X = motion.displacements()
    one = facelab.RegionModel(regions, 0.9).fit(X)
    many = facelab.RegionModel(regions, 0.9).fit(in_blocks(X))
    np.testing.assert_array_equal(many.n_components_, one.n_components_)


def test_a_wide_face_is_learned_within_the_error_of_its_randomised_modes(client, rng, monkeypatch):
    monkeypatch.setattr("facelab.models.components.LARGEST_EXACT", 100)
    strength = np.linspace(3, 0.5, 40)
    X = (rng.normal(size=(700, 40)) * strength) @ rng.normal(size=(40, 240)) / 10
    X += 0.3 * rng.normal(size=X.shape)
    one = facelab.HolisticModel(30).fit(X)
    many = facelab.HolisticModel(30).fit(in_blocks(X))
    np.testing.assert_allclose(many.variances_[0], one.variances_[0], rtol=1e-5)
    same = facelab.HolisticModel(30).fit_blocks([X[:300], X[300:]], passes=4, progress=False)
    np.testing.assert_allclose(many.reconstruct(X), same.reconstruct(X), atol=1e-6)
    errors = [facelab.rms_error(X, m.reconstruct(X)) for m in (one, many)]
    assert errors[0] <= errors[1] * (1 + 1e-12) and errors[1] < errors[0] * (1 + 1e-6)


def test_the_correlation_of_frames_on_workers_is_that_of_all_frames(client, moving):
    P = moving[0].positions.copy()
    P[:, 5] = P[0, 5]  # a still vertex
    np.testing.assert_allclose(motion_correlation(in_blocks(P)), motion_correlation(P), atol=EXACT)


@pytest.mark.parametrize("learn", ["model", "correlation"])
def test_a_block_with_a_gap_is_refused_by_its_number(client, moving, learn):
    P = moving[0].positions.copy()
    P[70, 3, 1] = np.nan
    with pytest.raises(ValueError, match="block 1"):
        if learn == "correlation":
            motion_correlation(in_blocks(P))
        else:
            facelab.HolisticModel(5).fit(in_blocks(P.reshape(len(P), -1)))


@pytest.mark.parametrize("shape", [(1, 12), (0, 12), (30,)])
def test_frames_that_teach_nothing_are_refused(client, shape):
    with pytest.raises(ValueError, match=r"frame|axes"):
        facelab.HolisticModel(2).fit(da.zeros(shape))


# --- takes ----------------------------------------------------------------------------------------


def work(item):
    what, flag = item
    if what == "poison":
        raise ValueError("this take is poisoned")
    if what == "killer" or (what == "killed once" and not os.path.exists(flag)):
        open(flag, "w").close()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return what


@pytest.mark.skipif(sys.platform == "win32", reason="workers are killed by a signal")
def test_poisoned_and_killing_takes_do_not_stop_the_others(client, tmp_path):
    names = ["a", "poison", "b", "killer", "c", "killed once", "d", "e"]
    items = [(name, str(tmp_path / name.replace(" ", "_"))) for name in names]
    found = {i: (result, error) for i, result, error in scale.each(work, items, client)}
    assert sorted(found) == list(range(8))
    for i, name in enumerate(names):
        result, error = found[i]
        if name == "poison":
            assert isinstance(error, ValueError) and "poisoned" in str(error)
        elif name == "killer":
            assert isinstance(error, scale.Killed) and "memory" in str(error)
        else:
            assert (result, error) == (name, None)


def test_a_worker_that_dies_comes_back_however_often(tmp_path):
    import dask

    items = [("killed once", str(tmp_path / str(k))) for k in range(4)]
    with (
        dask.config.set({"distributed.deploy.lost-worker-timeout": "1 ms"}),  # for others' clusters
        scale.cluster(workers=1, memory=None) as client,
    ):
        found = [(r, error) for _, r, error in scale.each(work, items, client, patience=5)]
    assert found == 4 * [("killed once", None)]


def test_a_result_lost_with_its_worker_is_made_once_more(client, monkeypatch):
    """The work is done again beside one that kills its workers, and counts as a killer itself."""
    from distributed import Future, KilledWorker

    fetched, result = [], Future.result

    def lost(future, timeout=None):
        fetched.append(future.key)
        if len(fetched) == 1:
            raise KilledWorker(future.key, None, 1)
        if len(fetched) == 2:
            raise TimeoutError
        return result(future, timeout)

    monkeypatch.setattr(Future, "result", lost)
    items = [(name, "") for name in "abc"]
    found = {i: (r, error) for i, r, error in scale.each(work, items, client)}
    assert found == {i: (name, None) for i, name in enumerate("abc")}
    assert len(set(fetched)) == 4  # one of three was submitted twice


LIMIT = 400 * 10**6  # bytes: a worker with facelab has half of it before it works
STEP = 2 * 10**6  # numbers


def hungry(item):
    """Take memory bit by bit: "much" without end, "leaves" what stands in the way of the next."""
    kept = [np.ones(1)]
    while item == "much" or (item == "leaves" and used() < 0.86 * LIMIT):
        kept.append(np.ones(STEP if item == "much" else STEP // 8))
        time.sleep(0.01)
        if len(kept) > 400:
            raise AssertionError("nobody stopped it")
    if item == "leaves":
        sys.left = kept
    return item


def used():
    import psutil

    return psutil.Process().memory_info().rss


def test_a_take_too_large_for_a_worker_is_told_and_the_others_are_done():
    with scale.cluster(workers=1, memory=LIMIT) as client:
        items = ["a", "much", "b"]
        found = {items[i]: (r, error) for i, r, error in scale.each(hungry, items, client)}
        error = found.pop("much")[1]
        assert isinstance(error, scale.Killed)
        assert "want of memory" in str(error) and "shorter takes" in str(error)
        assert found == {name: (name, None) for name in ("a", "b")}


def test_workers_that_stand_still_for_want_of_memory_are_started_anew(monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr("facelab.numeric.engine.STUCK", 1.0)
    with (
        LocalCluster(
            n_workers=1, threads_per_worker=1, memory_limit=LIMIT, dashboard_address=None,
            silence_logs=50,
        ) as own,
        scale.cluster(own.scheduler_address) as client,
    ):  # fmt: skip
        assert [r for _, r, _ in scale.each(hungry, ["leaves"], client)] == ["leaves"]
        found = list(scale.each(hungry, ["a", "b"], client))
        assert sorted(r for _, r, _ in found) == ["a", "b"]


def test_learning_that_no_worker_has_room_for_names_the_blocks_and_the_remedy():
    X = da.random.default_rng(0).normal(size=(24_000, 3000), chunks=(12_000, 3000))
    with scale.cluster(workers=1, memory=LIMIT):
        with pytest.raises(scale.Killed) as caught:
            facelab.HolisticModel(2).fit(X)
        told = "12000 frames of 3000 numbers, 288 MB", "chunks of 3000 frames", "`memory`"
        for part in told:
            assert part in str(caught.value)
        small = da.random.default_rng(0).normal(size=(2000, 300), chunks=(500, 300))
        assert facelab.HolisticModel(2).fit(small).n_components == 2


def test_without_any_worker_all_is_told_as_not_reached(monkeypatch):
    from distributed import LocalCluster

    with (
        LocalCluster(n_workers=0, dashboard_address=None, processes=True) as empty,
        scale.cluster(empty.scheduler_address) as client,
    ):
        found = list(scale.each(work, [("a", ""), ("b", "")], client, patience=1))
    assert [i for i, _, _ in found] == [0, 1]
    assert all(isinstance(error, scale.Lost) for _, _, error in found)


def test_frames_of_many_takes_leave_out_what_cannot_be_read(client, moving, tmp_path):
    motion, regions = moving
    lost = np.ones(len(motion.positions), dtype=bool)
    lost[::7] = False
    for i, valid in enumerate((lost, ~lost, lost)):
        take = MotionSequence(motion.positions * (1 + i / 99), 30.0, motion.mesh, valid)
        files.write_motion(tmp_path / f"{i}.npz", take)
    other = grid_mesh(5, 5, 8.0)
    files.write_motion(tmp_path / "3.npz", MotionSequence(other.vertices[None], 30.0, other))
    (tmp_path / "1.npz").write_bytes((tmp_path / "1.npz").read_bytes()[:900])  # poisoned
    paths = [tmp_path / f"{i}.npz" for i in range(4)]
    frames = scale.frames_of(paths, client)
    assert sorted(frames.failed) == [str(paths[1]), str(paths[3])]
    assert "another neutral" in frames.failed[str(paths[3])]
    X = np.concatenate([files.read_motion(paths[i]).displacements() for i in (0, 2)])
    np.testing.assert_array_equal(frames.X.compute(), X)
    np.testing.assert_allclose(
        frames.positions[3].compute().ravel() - X[3], motion.mesh.vertices.ravel()
    )
    one, many = (facelab.RegionModel(regions, 6).fit(frame) for frame in (X, frames.X))
    np.testing.assert_allclose(many.reconstruct(X), one.reconstruct(X), atol=1e-6)
    samples, control = motion.mesh.subsample(40)
    few = scale.frames_of(paths, client, samples, control)
    wanted = X.reshape(len(X), -1, 3)[:, samples].reshape(len(X), -1)
    np.testing.assert_array_equal(few.X.compute(), wanted)
    with pytest.raises(ValueError, match="not one take"):
        scale.frames_of(paths[1:2], client)


# --- commands -------------------------------------------------------------------------------------


def test_a_command_on_workers_makes_what_it_makes_alone(tmp_path, client, capsys):
    (tmp_path / "in").mkdir()
    for name, columns in (("a", 12), ("c", 14)):
        files.write_obj(tmp_path / "in" / f"{name}.obj", grid_mesh(columns, 10, 15.0))
    (tmp_path / "in" / "b.obj").write_text("v 0 0 0\nv 1 0\n")
    made = []
    for more in ([], ["--scheduler", client.scheduler.address]):
        out, report = tmp_path / f"out{len(made)}", tmp_path / "report.json"
        arguments = ["convert", str(tmp_path / "in"), "-o", str(out), "--to", "ply"]
        assert main([*arguments, "--report", str(report), *more]) == 1
        told = json.loads(report.read_text())
        assert [f["input"] for f in told["failed"]] == [str(tmp_path / "in" / "b.obj")]
        assert "line 2" in told["failed"][0]["reason"]
        made.append(
            (
                sorted((d["input"], d["vertices"], *d["warnings"]) for d in told["done"]),
                {p.name: p.read_bytes() for p in out.iterdir()},
            )
        )
    assert made[0] == made[1] and len(made[0][1]) == 2
    assert capsys.readouterr().err.count("b.obj") == 2


def test_a_scheduler_that_does_not_answer_is_told_by_its_address(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("facelab.scale.machines.WAIT", 0.5)
    files.write_obj(tmp_path / "a.obj", grid_mesh(12, 10, 15.0))
    arguments = ["convert", str(tmp_path / "a.obj"), "-o", str(tmp_path / "a.ply")]
    assert main([*arguments, "--scheduler", "tcp://127.0.0.1:9"]) == 1
    assert "no Dask scheduler answers at 'tcp://127.0.0.1:9'" in capsys.readouterr().err
    assert main([*arguments, "--scheduler", "tcp://127.0.0.1:9", "--workers", "2"]) == 2
    assert main([*arguments, "--workers", "0"]) == 2


def test_without_dask_it_is_said_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    files.write_obj(tmp_path / "a.obj", grid_mesh(12, 10, 15.0))
    arguments = ["convert", str(tmp_path / "a.obj"), "-o", str(tmp_path / "a.ply")]
    assert main([*arguments, "--workers", "2"]) == 1
    assert "pip install 'facelab[scale]'" in capsys.readouterr().err
    assert main(arguments) == 0
