"""Model files that were changed on their way are refused, or are what they say."""

import io
import re
import resource
import zipfile
from collections import Counter

import numpy as np
import pytest
from mutants import BINARY, BYTES, COUNT, verdict
from planted import corner_regions, quarters

from facelab.models.global_local import GlobalLocalModel
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.models.store import load_model
from facelab.segmentation.regions import Regions


def models():
    """A model of each kind of file: learned, carried to a dense mesh, whole, given."""
    rng = np.random.default_rng(1)
    mesh, labels = quarters(9, 8)
    samples, small = mesh.subsample(30)
    dense = Regions(labels[samples], small, "both", 2).carried_to(mesh, samples)
    X = rng.normal(size=(30, 126))
    return {
        "learned": RegionModel(corner_regions(), 3).fit(X),
        "total": RegionModel(corner_regions(), 9, spread="total", blending="gradient").fit(X),
        "dense": RegionModel(dense, 2).fit(rng.normal(size=(20, 216))),
        "whole": HolisticModel().fit(X),
        "between": GlobalLocalModel(corner_regions(), 4).fit(X),
        "given": RegionModel.from_bases(corner_regions(), np.ones(126), rng.normal(size=(3, 126))),
    }


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Files of all of them: name to bytes."""
    folder, found = tmp_path_factory.mktemp("models"), {}
    for name, model in models().items():
        model.save(folder / f"{name}.npz")
        found[name] = (folder / f"{name}.npz").read_bytes()
    return found


# --- files pulled apart and put together ----------------------------------------------------------


def unpacked(data):
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {n: archive.read(n) for n in archive.namelist()}


def packed(members):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members:
            archive.writestr(name, data)
    return out.getvalue()


def array_of(data):
    return np.lib.format.read_array(io.BytesIO(data))


def bytes_of(array):
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asanyarray(array))
    return out.getvalue()


def with_array(data, name, array):
    """The file with one array put in or changed."""
    members = unpacked(data)
    members[f"{name}.npy"] = bytes_of(array)
    return packed(members.items())


def without(data, *names):
    """The file without some arrays, and with a list of arrays that does not miss them."""
    members = unpacked(data)
    for name in names:
        del members[f"{name}.npy"]
    listed = array_of(members["facelab_arrays.npy"])
    members["facelab_arrays.npy"] = bytes_of(listed[~np.isin(listed, names)])
    return packed(members.items())


def changed(data, name, change):
    return with_array(data, name, change(array_of(unpacked(data)[f"{name}.npy"]).copy()))


def put(value, at=0):
    def change(array):
        array.flat[at] = value
        return array

    return change


# --- what is refused ------------------------------------------------------------------------------

REFUSED = {
    "negative variance": ("learned", "variances", put(-1.0, -1), "variances are negative"),
    "rising variance": ("learned", "variances", put(99.0, 1), "rise within a region"),
    "variance not finite": ("learned", "variances", put(np.nan), "variances holds 1"),
    "too few variances": ("learned", "variances", lambda a: a[:-1], r"variances has shape \(11,\)"),
    "mean not finite": ("learned", "mean", put(np.inf), "mean holds 1 value"),
    "short mean": ("learned", "mean", lambda a: a[:-3], "123 columns, but the regions"),
    "mean of integers": ("learned", "mean", lambda a: a.astype(int), "numbers are wanted"),
    "modes not finite": ("learned", "components", put(np.nan), "components holds 1"),
    "few modes": ("learned", "components", lambda a: a[:-5], "components has shape"),
    "flat modes": ("learned", "components", lambda a: a[None], "components has shape"),
    "other counts": ("learned", "counts", lambda a: a - 1, "components has shape"),
    "negative counts": ("learned", "counts", put(-3), "counts=.* are no numbers of modes"),
    "more counts than asked": ("learned", "counts", put(9), "counts=.* are no numbers of modes"),
    "more modes in all": ("total", "counts", put(9), "counts=.* are no numbers of modes"),
    "too few counts": ("learned", "counts", lambda a: a[:-1], r"counts has shape \(3,\)"),
    "no modes at all": ("learned", "counts", lambda a: 0 * a, "counts=.* are no numbers of modes"),
    "counts of another kind": ("learned", "counts", lambda a: a * 1.0, "integers are wanted"),
    "beta": ("learned", "beta", lambda a: -a, "beta=-0.5"),
    "beta not finite": ("learned", "beta", lambda a: a * np.nan, "beta=nan"),
    "spread": ("learned", "spread", lambda a: np.array("wide"), "spread='wide'"),
    "blending": ("learned", "blending", lambda a: np.array("soft"), "blending='soft'"),
    "kind": ("learned", "model", lambda a: np.array("Rig"), "model='Rig' is unknown"),
    "whole with regions": ("learned", "model", lambda a: np.array("HolisticModel"), "cannot have"),
    "share": ("learned", "n_components", lambda a: np.array(1.5), "n_components=1.5"),
    "labels": ("learned", "labels", put(-1), "labels must use every number"),
    "labels of another kind": ("learned", "labels", lambda a: a + 0.5, "integers are wanted"),
    "few labels": ("learned", "labels", lambda a: a[:-1], r"labels has shape \(41,\)"),
    "triangles": ("learned", "faces", put(42), "faces"),
    "vertices not finite": ("learned", "vertices", put(np.nan), "vertices"),
    "sharing": ("learned", "sharing", lambda a: np.array("all"), "sharing='all'"),
    "rings": ("learned", "rings", lambda a: np.array(0), "rings=0"),
    "held": ("dense", "held", lambda a: a[:, :-1], "held has shape"),
    "held by none": ("dense", "held", lambda a: a & False, "held has shape"),
    "samples": ("dense", "samples", put(72), "samples holds 72"),
    "samples twice": ("dense", "samples", lambda a: np.r_[a[:-1], a[0]], "more than once"),
    "landmarks": ("learned", "landmarks", lambda a: np.array([3]), "landmarks has shape"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_whose_arrays_do_not_fit_together_is_refused(files, tmp_path, name):
    kind, array, change, message = REFUSED[name]
    path = tmp_path / "model.npz"
    path.write_bytes(changed(files[kind], array, change))
    with pytest.raises(ValueError, match=rf"model\.npz: parts of it .*{message}.*; save it again"):
        load_model(path)


def test_a_file_without_one_of_its_arrays_is_refused(files, tmp_path):
    path = tmp_path / "model.npz"
    for data in files.values():
        for name in array_of(unpacked(data)["facelab_arrays.npy"]):
            members = unpacked(data)
            del members[f"{name}.npy"]
            path.write_bytes(packed(members.items()))
            with pytest.raises(ValueError, match=rf"\({name} should be there\)"):
                load_model(path)
            if name in ("variances", "held", "samples", "labels"):
                continue  # a whole kind of file is without them
            path.write_bytes(without(data, name))
            with pytest.raises(ValueError, match=r"it has no|should not be there"):
                load_model(path)


def test_files_from_before_they_listed_their_arrays_are_read(files, tmp_path):
    path = tmp_path / "model.npz"
    for name, model in models().items():
        members = unpacked(files[name])
        del members["facelab_arrays.npy"]
        path.write_bytes(packed(members.items()))
        np.testing.assert_array_equal(load_model(path).components_[0], model.components_[0])


@pytest.mark.parametrize("name", models())
def test_every_kind_of_model_comes_back_with_its_settings(files, tmp_path, name):
    path, model = tmp_path / "model.npz", models()[name]
    path.write_bytes(files[name])
    back = load_model(path)
    assert type(back) is type(model)
    for setting in {"n_components", "beta", "spread", "blending"} & model.get_params().keys():
        assert getattr(back, setting) == getattr(model, setting)
    X = np.random.default_rng(2).normal(size=(3, len(model.mean_)))
    np.testing.assert_array_equal(back.transform(X), model.transform(X))
    assert (back.variances_ is None) == (model.variances_ is None)


# --- files that ask for memory --------------------------------------------------------------------


def test_an_array_that_nobody_asked_for_is_never_read(files, tmp_path):
    path = tmp_path / "model.npz"
    zeros = np.zeros(2**24)  # 134 MB
    members = unpacked(with_array(files["learned"], "extra", zeros))
    del members["facelab_arrays.npy"]  # as a file from before, that does not list its arrays
    path.write_bytes(packed(members.items()))
    assert path.stat().st_size < 2**18
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match="extra should not be there"):
        load_model(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000  # kB


def test_arrays_larger_than_the_face_asks_for_are_not_read(files, tmp_path):
    path = tmp_path / "model.npz"
    for name in ("components", "variances", "counts", "labels", "landmarks"):
        large = np.zeros(2**24, dtype=array_of(unpacked(files["learned"])[f"{name}.npy"]).dtype)
        path.write_bytes(with_array(files["learned"], name, large))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with pytest.raises(ValueError, match=f"{name} has shape"):
            load_model(path)
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000


# --- three hundred mutants ------------------------------------------------------------------------


def pick(rng, items):
    return items[int(rng.integers(len(items)))]


def inside(change):
    """The change of one member's bytes, its checksum put right."""

    def mutate(data, rng):
        members = unpacked(data)
        name = pick(rng, list(members))
        members[name] = bytes(change(members[name], rng))
        return packed(members.items())

    return mutate


def of_array(change):
    """The change of one array."""

    def mutate(data, rng):
        members = unpacked(data)
        name = pick(rng, [n for n in members if array_of(members[n]).size])
        members[name] = bytes_of(change(array_of(members[name]).copy(), rng))
        return packed(members.items())

    return mutate


def strange(array, rng):
    odd = ["", "x", "RegionModel"] if array.dtype.kind == "U" else [-1, 0, 1, 7, 10**6]
    odd += [np.nan, np.inf, -np.inf, 1e308, -0.5] * (array.dtype.kind == "f")
    array.flat[int(rng.integers(array.size))] = pick(rng, odd)
    return array


def reshaped(array, rng):
    ways = [array.ravel(), array[None], array.T, array[..., None]]
    if array.ndim:
        ways += [array[:-1], array[1:], np.repeat(array, 2, axis=0), array[:0], array[::-1]]
    return pick(rng, ways)


def retyped(array, rng):
    kind = pick(rng, ["f4", "i8", "u1", "?", "U8", "S4", "c16", "f2"])
    try:
        with np.errstate(all="ignore"):
            return array.astype(kind)
    except ValueError:
        return np.zeros(array.shape, kind)


def swapped(data, rng):
    members = unpacked(data)
    a, b = pick(rng, list(members)), pick(rng, list(members))
    members[a], members[b] = members[b], members[a]
    return packed(members.items())


def doubled(data, rng):
    members = list(unpacked(data).items())
    return packed([*members, pick(rng, members)])


def dropped(data, rng):
    members = list(unpacked(data).items())
    del members[int(rng.integers(len(members)))]
    return packed(members)


def renamed(data, rng):
    members = list(unpacked(data).items())
    k = int(rng.integers(len(members)))
    members[k] = (
        bytes(BYTES["bit flipped"](members[k][0].encode(), rng)).decode("latin-1"),
        members[k][1],
    )
    return packed(members)


def vast(data, rng):
    """A header that promises more than there is."""
    members = unpacked(data)
    name = pick(rng, list(members))
    head = re.sub(rb"'shape': \((\d*)", rb"'shape': (9\g<1>", members[name][:128])
    members[name] = head + members[name][128:]
    return packed(members.items())


DAMAGE = [*BYTES.values(), *BINARY.values()]
MUTATIONS = [
    *DAMAGE,
    *map(inside, DAMAGE),
    *map(of_array, (strange, strange, reshaped, retyped)),
    *(swapped, doubled, dropped, renamed, vast),
]


def contradiction(model):
    """What in an accepted model cannot be, "" if nothing."""
    P, N = model.n_components_, len(model.mean_)
    members = model.members_ or [np.arange(N // 3)]
    modes = np.concatenate([B.ravel() for B in model.components_])
    wrong = {
        "numbers not finite": not (np.isfinite(model.mean_).all() and np.isfinite(modes).all()),
        "sizes": [B.shape for B in model.components_]
        != [(p, 3 * len(m)) for p, m in zip(P, members, strict=True)],
        "no modes": P.sum() == 0,
        "beta": not 0 <= model.beta < np.inf,
        "vertices": max(m.max() for m in members) >= N // 3,
    }
    if model.variances_ is not None:
        v = np.concatenate(model.variances_)
        wrong["variances"] = not (np.isfinite(v).all() and (v >= 0).all() and len(v) == P.sum())
    if isinstance(model.n_components, int):
        wrong["more modes than asked for"] = P.max() > model.n_components
    if model.regions is not None:
        mesh, samples = model.regions.mesh, model.regions.samples
        wrong |= {
            "another face": 3 * mesh.n_vertices != N or len(model.regions.labels) * 3 != N,
            "regions": model.regions.n_regions != len(P),
            "triangles": mesh.faces.min() < 0 or mesh.faces.max() >= mesh.n_vertices,
            "mesh not finite": not np.isfinite(mesh.vertices).all(),
            "samples": samples is not None and not 0 <= min(samples) <= max(samples) < N // 3,
        }
    return ", ".join(name for name, is_so in wrong.items() if is_so)


def tally(files, n, rng, path):
    """Verdicts on `n` mutants, and those that are wrong or not in our words."""
    counts, bad = Counter(), []
    while counts.total() < n:
        mutation, data = pick(rng, MUTATIONS), pick(rng, list(files.values()))
        mutant = bytes(mutation(data, rng))
        if mutant == data:
            continue
        found = verdict(load_model, mutant, path)
        kind, why = found.kind, found.message
        if kind == "accepted" and (why := contradiction(found.result)):
            kind = "wrong"
        counts[kind] += 1
        if kind in ("wrong", "python"):
            bad.append(f"{mutation.__name__}: {kind}: {why}")
    return counts, bad


@pytest.mark.filterwarnings("ignore:Duplicate name", "ignore:Reading `.npy`")
def test_no_mutant_of_a_model_file_is_wrongly_accepted_or_refused_unclearly(files, tmp_path):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    counts, bad = tally(files, COUNT, np.random.default_rng(20110807), tmp_path / "model.npz")
    assert not bad, "\n".join(bad[:10])
    assert counts["refused"] > COUNT / 2
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB
