"""Long trials of what must never break. `python tests/soak.py walks 20000 --seed 3`

Each trial is a function of a number and a seed; it raises at the first fault and returns what it
did, counted. The tests run each in a small form.
"""

import argparse
import tempfile
import time
import warnings
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
from planted import bumps, bumpy_rig, corner_regions
from shapes import grid_mesh
from writers import Written
from writers import kills as killed
from writers import starvation as starved

from facelab.expression.session import BOUNDS, ExpressionSession
from facelab.expression.units import prepare_units
from facelab.files.obj import write_obj
from facelab.files.poses import load_pose, read_log, save_pose
from facelab.files.takes import read_weights
from facelab.geometry.binding import bind_to_samples
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.motion import MotionSequence
from facelab.posing.clips import interpolate
from facelab.posing.log import replay
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig

BAD_SHARE = 0.25
JUNK = (
    *(
        None,
        True,
        "no",
        "0.25",
        b"1",
        object(),
        [],
        {},
        (1, 2),
        [[1.0]],
        ["a"] * 3,
        np.zeros((2, 2)),
    ),
    *(np.nan, np.inf, -np.inf, -1, 0, 1e-300, -1e-3, 1e12, 1e308, -1e308, 10**400, 1.5, 3j),
    *([np.nan, 0, 0], [1e308, 0, 0], [True, 0, 0], ["1", "2", "3"], [10**400, 0, 0], np.ma.masked),
)


class Walk:
    """A session, walked at random: `actions` do what a hand can, `aims` are for junk.

    Parameters
    ----------
    session : PosingSession or ExpressionSession
    rng : numpy Generator
    folder : Path
        For files.
    """

    most = None  # steps of undo kept, where not all are
    every = 60  # actions between two checks of files, log and undo

    def __init__(self, session, rng, folder):
        self.session, self.rng, self.folder = session, rng, Path(folder)
        self.done, self.start, self.full = Counter(), session.state, False

    def moment(self):
        """All that a refused action must leave as it was."""
        return {k: v for k, v in vars(self.session.history).items() if k != "_observers"}

    def go(self, n_actions):
        """Walk so many actions; returns how many were done and refused."""
        for k in range(1, n_actions + 1):
            bad = self.rng.random() < BAD_SHARE
            self.step(*(self.bad() if bad else self.good()), bad)
            self.full |= self.session.n_undo == self.most  # the first steps fall out from here on
            if k % self.every == 0 or k == n_actions:
                self.check()
        return self.done

    def step(self, name, action, bad):
        before, V = self.moment(), self.session.vertices
        try:
            action()
        except (ValueError, TypeError, FileNotFoundError) as error:
            assert not isinstance(error, np.linalg.LinAlgError), (name, error)
            assert self.moment() == before, f"{name} was refused ({error}) and left a trace"
            np.testing.assert_array_equal(self.session.vertices, V, name)
            self.done["bad refused" if bad else "refused"] += 1
        else:
            self.done["bad done" if bad else "done"] += 1
        assert np.isfinite(self.session.vertices).all(), name

    def pick(self, options):
        return options[int(self.rng.integers(len(options)))]

    def good(self):
        name = self.pick(sorted(self.actions()))
        return name, self.actions()[name]

    def bad(self):
        """An action with one of its arguments junk."""
        name, call, arguments = self.pick(self.aims())
        k = int(self.rng.integers(len(arguments)))
        given = [*arguments[:k], self.pick(JUNK), *arguments[k + 1 :]]
        return f"{name}{given}", partial(call, *given)

    def group(self):
        """Some actions as one step; one that is refused takes back all."""
        key = self.pick([None, "a", "b"])
        with self.session.group(key):
            for _ in range(int(self.rng.integers(4))):
                self.pick([a for n, a in sorted(self.actions().items()) if n not in self.alone])()

    def back_and_forth(self):
        """All steps undone and redone, exactly."""
        session, here = self.session, self.session.state
        session.cancel()
        back = session.history.states[: session.n_undo + 1]
        V = session.vertices
        n = 0
        while session.undo():
            n += 1
            assert session.state is back[n]
        assert n == len(back) - 1 and (session.state is self.start or self.full)
        while n and session.redo():
            n -= 1
        assert session.state is here
        np.testing.assert_array_equal(session.vertices, V)


class PosingWalk(Walk):
    """A posing session on models of each kind."""

    alone = ("undo", "redo", "group", "file")

    def __init__(self, models, make, rng, folder):
        self.models, self.make, self.states = models, make, []
        super().__init__(make(), rng, folder)

    def vertex(self):
        if self.session.pins and self.rng.random() < 0.4:
            return self.pick(list(self.session.pins))
        return int(self.rng.integers(self.session.neutral.n_vertices))

    def target(self, v):
        far = self.pick([1.0, 1, 5, 5, 50, 1e4])
        return self.session.vertices[v] + far * self.rng.normal(size=3)

    def actions(self):
        s, rng, v = self.session, self.rng, self.vertex()
        region = int(rng.integers(1 if s.regions is None else 4))
        share = rng.uniform(0, 1, s.model.n_coefficients)
        value = rng.uniform(*s.mold_ranges(region)[0])
        k = int(rng.integers(len(s.mold_names(region))))
        return {
            "press": lambda: s.press(v),
            "drag": lambda: s.drag(v, self.target(v)),
            "drag on": lambda: [s.drag(v, self.target(v)) for _ in range(3)],
            "release": s.release,
            "cancel": s.cancel,
            "pull": lambda: s.pull(v, self.target(v)),
            "hold": lambda: s.hold(v),
            "set_pin": lambda: s.set_pin(v, self.pick([None, self.target(v)]), **self.pinned()),
            "remove_pin": lambda: s.remove_pin(v),
            "mirror_pin": lambda: s.mirror_pin(v),
            "keep": s.keep,
            "reset": s.reset,
            "reset_region": lambda: s.reset_region(region),
            "set": lambda: s.set(**self.settings()),
            "apply": lambda: s.apply(share),
            "restore": lambda: s.restore(self.pick([*self.states, s.state])),
            "remember": lambda: self.states.append(s.state),
            "mirror": s.mirror,
            "use": lambda: s.use(self.pick(self.models)),
            "mold": lambda: s.mold(region, k, value),
            "slide": partial(self.slide, region, k),
            "symmetric": lambda: setattr(s, "symmetric", bool(rng.integers(2))),
            "settle": s.settle,
            "undo": s.undo,
            "undo more": s.undo,
            "redo": s.redo,
            "group": self.group,
            "look": self.look,
            "file": self.file,
        }

    alone = (*alone, "undo more")

    def pinned(self):
        weight = self.pick([None, 1, 0.1, 10, 10 ** self.rng.uniform(-6, 6)])
        return {"weight": weight, "locked": self.pick([None, None, True, False])}

    def settings(self):
        options = {
            "beta": [0, 0.5, 10 ** self.rng.uniform(-3, 6)],
            "gamma": [0.025, 10 ** self.rng.uniform(-9, 9)],
            "limit": [None, None, 3.0, 10 ** self.rng.uniform(-2, 3)],
        }
        return {k: self.pick(v) for k, v in options.items() if self.rng.random() < 0.5}

    def slide(self, region, k):
        for value in self.rng.uniform(*self.session.mold_ranges(region)[0], size=4):
            with self.session.group(f"mold {region} {k}"):
                self.session.mold(region, k, value)

    def look(self):
        s = self.session
        (
            s.plausibility(),
            s.gaps(),
            s.mold_values(0),
            s.pins,
            s.pin_weights,
            s.region_labels,
            s.models,
        )
        s.overlay(np.zeros((2, s.model.n_coefficients)))

    def file(self):
        """The pose that was saved is the pose loaded, one step further."""
        path = self.folder / "walk.json"
        save_pose(path, self.session)
        saved = self.session.state
        load_pose(path, self.session, self.models)
        assert self.session.state.same(saved)

    def aims(self):
        s, v = self.session, self.vertex()
        place = s.neutral.vertices[v] + 1
        return [
            ("press", s.press, [v]),
            ("drag", s.drag, [v, place]),
            ("pull", s.pull, [v, place]),
            ("hold", s.hold, [v]),
            ("set_pin", s.set_pin, [v, place, 2.0, True]),
            ("remove_pin", s.remove_pin, [v]),
            ("mirror_pin", s.mirror_pin, [v]),
            ("reset_region", s.reset_region, [0]),
            ("set", s.set, [0.5, 0.025, 3.0]),
            ("apply", s.apply, [np.zeros(s.model.n_coefficients)]),
            ("apply all", lambda x: s.apply([x] * s.model.n_coefficients), [0.0]),
            ("restore", s.restore, [s.state]),
            ("use", s.use, [s.model]),
            ("mold", s.mold, [0, 0, 0.5]),
            ("symmetric", partial(setattr, s, "symmetric"), [True]),
            ("vertices_of", s.vertices_of, [s.coefficients]),
            ("encode", s.encode, [None]),
            ("overlay", s.overlay, [np.zeros((2, s.model.n_coefficients))]),
            ("mold_values", s.mold_values, [0]),
            ("mold_names", s.mold_names, [0]),
            ("interpolate", interpolate, [s.state, s.state, 0.5]),
            ("group", self.named_group, ["key", "beta"]),
            ("replay", self.replay_of, ["mold", 0.5]),
        ]

    def named_group(self, key, beta):
        with self.session.group(key):
            self.session.keep()
            self.session.set(beta=beta)

    def replay_of(self, do, value):
        entries = [{"do": "hold"}, {"do": "keep"}, {"do": "set", "beta": value}, {"do": do}]
        replay(entries[int(self.rng.integers(4)) :], self.session)

    def check(self):
        self.back_and_forth()
        session, path = self.session, self.folder / "walk.json"
        save_pose(path, session)
        again = replay(read_log(path), self.make(), self.models)
        assert again.state.same(session.state), "the log ends in another pose"
        assert (again.n_undo, again.n_redo) == (session.n_undo, session.n_redo)
        assert again.symmetric == session.symmetric
        assert [_timeless(e) for e in again.log] == [_timeless(e) for e in session.log]
        other = self.make()
        load_pose(path, other, self.models)
        assert other.state.same(session.state), "the pose that was saved is another"
        np.testing.assert_array_equal(other.vertices, session.vertices)
        if session.n_undo > 150:  # begin afresh, or the log takes all the time
            self.session, self.states = self.make(), []
            self.start = self.session.state


def _timeless(entry):
    return {k: v for k, v in entry.items() if k != "t"}


class ExpressionWalk(Walk):
    """An expression session."""

    most = 200

    alone = ("undo", "undo more", "redo", "group", "file")

    def sketch(self):
        rig, rng = self.session.rig, self.rng
        w = rng.uniform(0, 1, len(rig.names)) * (rng.random(len(rig.names)) < 0.4)
        return rig.shape(w) + rng.normal(scale=self.pick([0, 0.3]), size=rig.neutral.vertices.shape)

    def frame(self):
        mesh = self.session.rig.neutral
        valid = np.array([True, False])
        return MotionSequence(np.stack([self.sketch()] * 2), 30, mesh, valid)

    def actions(self):
        s, rng, name = self.session, self.rng, self.pick(self.session.names)
        return {
            "load": lambda: s.load(self.sketch(), self.pick(["a", "b"])),
            "load live": lambda: [s.load(self.sketch(), "c", live=True) for _ in range(3)],
            "load_frame": lambda: s.load_frame(self.frame(), int(rng.integers(2))),
            "alpha": lambda: s.set(alpha=self.pick(["best", *rng.uniform(0, 100, 2)])),
            "slide": lambda: [s.set(alpha=float(a)) for a in rng.uniform(0, 9, 4)],
            "lam": lambda: s.set(lam=self.pick([0, 1.0, 10 ** rng.uniform(-3, 3)])),
            "bounds": lambda: s.set(bounds=self.pick(list(BOUNDS))),
            "criterion": lambda: s.set(criterion=self.pick(["e_rms", "gcv", "fewest", "held_out"])),
            "align": lambda: s.set(align=self.pick(["check", True, False])),
            "clamp": lambda: s.set(clamp=bool(rng.integers(2)), alpha="best"),
            "lock": lambda: s.lock(name, self.pick([None, *rng.uniform(-1, 2, 2), 1000.0])),
            "exclude": lambda: s.exclude(name),
            "free": lambda: s.free(name),
            "free all": s.free,
            "settle": s.settle,
            "undo": s.undo,
            "undo more": s.undo,
            "redo": s.redo,
            "group": self.group,
            "file": self.file,
        }

    def file(self):
        write_obj(self.folder / "sketch.obj", self.session.rig.neutral.with_vertices(self.sketch()))
        self.session.load_file(self.folder / "sketch.obj")

    def aims(self):
        s, name = self.session, self.pick(self.session.names)
        return [
            ("load", s.load, [self.sketch(), "a"]),
            ("load all", lambda x: s.load([[x] * 3] * len(s.sketch)), [1.0]),
            ("load_file", s.load_file, [self.folder / "none.obj", 1.0]),
            ("load_frame", s.load_frame, [self.frame(), 0]),
            ("set", s.set, [1.0, 1.0, "0 to 1", "e_rms", True, True]),
            ("lock", s.lock, [name, 0.5]),
            ("exclude", s.exclude, [name]),
            ("free", s.free, [name]),
            ("on", s.on, [s.rig]),
            ("take", s.take, [30.0]),
            ("save", s.save, [self.folder / "bad.csv"]),
            ("group", self.named_group, ["key", 1.0]),
        ]

    def named_group(self, key, lam):
        with self.session.group(key):
            self.session.free()
            self.session.set(lam=lam)

    def check(self):
        self.back_and_forth()
        session = self.session
        session.save(self.folder / "walk.csv")
        saved = read_weights(self.folder / "walk.csv")
        np.testing.assert_array_equal(saved.weights[0], session.weights)
        if 0 <= session.weights.min() and session.weights.max() <= 1:
            session.save(self.folder / "walk.json")
            posing = PosingSession(session.rig, session.rig.neutral)
            load_pose(self.folder / "walk.json", posing)
            np.testing.assert_array_equal(posing.coefficients, session.weights)


def _posing_walks(rng, folder):
    """A walk on the model's own face, and one on a dense face that follows it."""
    regions = corner_regions()
    X = bumps(regions.mesh, regions.labels, rng) + rng.normal(scale=0.2, size=(80, 126))
    rig = BlendshapeRig(regions.mesh, "abcde", rng.normal(size=(5, 42, 3)))
    models = [RegionModel(regions, 5).fit(X), HolisticModel(6).fit(X), rig]
    yield PosingWalk(models, partial(PosingSession, models[0], regions.mesh), rng, folder)
    dense = grid_mesh(13, 11, 5.0)
    row, column = np.divmod(np.arange(dense.n_vertices), 13)
    binding = bind_to_samples(dense, np.flatnonzero((row % 2 == 0) & (column % 2 == 0)))
    shared = {"binding": binding, "shared_pins": "copies"}
    yield PosingWalk(models, partial(PosingSession, models[1], dense, **shared), rng, folder)


def walks(n_actions, seed=0):
    """Random walks over all that a person can do in both sessions, a quarter of the actions bad.

    Raises
    ------
    AssertionError
        If a refused action leaves a trace, undo or redo do not return exactly, a log or a file
        gives another pose, a pose is not finite, or an error is not in our words.
    """
    rng = np.random.default_rng(seed)
    found = {}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        for name, walk in zip(("posing", "bound"), _posing_walks(rng, folder), strict=True):
            found[name] = walk.go(2 * n_actions // 5)
        session = ExpressionSession(prepare_units(bumpy_rig()))
        found["expression"] = ExpressionWalk(session, rng, folder).go(n_actions // 5)
    return found


def kills(n, seed=0):
    """Writers of every kind of file, killed at random moments; see `tests/writers.py`."""
    with tempfile.TemporaryDirectory() as folder:
        return killed(Written(folder), n, seed)


def starvation(n, seed=0):
    """Writers of every kind of file on a full disk."""
    with tempfile.TemporaryDirectory() as folder:
        return starved(Written(folder), n, seed)


TRIALS = {"walks": (walks, 20_000), "kills": (kills, 1000), "starvation": (starvation, 300)}


def main():
    """Run one trial, or each, and print what it did."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("trial", nargs="?", choices=[*TRIALS, "all"], default="all")
    parser.add_argument("number", nargs="?", type=int)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    for name, (trial, number) in TRIALS.items():
        if given.trial in (name, "all"):
            number, start = given.number or number, time.perf_counter()
            found = trial(number, given.seed)
            print(f"{name}, {number}, {time.perf_counter() - start:.0f} s: {found}", flush=True)


if __name__ == "__main__":
    main()
