"""Local and global linear face models side by side; `make results` writes the tables.

Each model learns from one take or person and rebuilds noisy frames of another; errors are against
those frames and against the truth behind them. Two axes: *parameters*, what is keyed or sent for
a frame, and *components*, the numbers that a model stores over three times its vertices, which is
what it costs in memory and arithmetic: 13 regions of 10 modes have 130 parameters and store about
as much as 10 modes of the whole face. Locality is what moves beyond 40 mm when the corner of the
mouth is pulled, at equal following.
"""

from typing import NamedTuple

import numpy as np
from tqdm.auto import tqdm

from facelab import data
from facelab.face_model import FaceModel
from facelab.models.evaluation import rms_error
from facelab.models.global_local import GlobalLocalModel
from facelab.models.holistic import HolisticModel
from facelab.models.localised import localised_model, varimax
from facelab.models.region import RegionModel
from facelab.posing.ranges import GAMMA
from facelab.posing.solver import PoseSolver
from facelab.studies import benchmark_data

SIZES = (20, 60, 100, 130, 200)
"""Parameters in all."""

EACH = (1, 2, 5, 10, 20)
"""Modes in each region, and of a whole-face model beside it."""

GLOBAL = 10
"""Modes of the whole face before regions of the rest."""

SPARSE_FRAMES, SPARSE_MOST = 300, 100
"""Frames that sparse localised components are learned from, evenly picked, and the most of them
that are learned: it takes long."""

FAR = 40.0
"""Millimetres from a pulled vertex beyond which motion is called far."""

PULL = np.array([4.0, 6.0, -2.0])
PULL *= 8 / np.linalg.norm(PULL)
"""How the corner of the mouth is pulled: 8 mm, outwards and up."""

GAMMAS = 1e-4, 10.0
"""Where a gamma is looked for that makes it follow so far."""

LOCAL_SIZES = {"total": (60, 130), "each": (10,)}
"""Sizes whose locality is measured."""

FOLLOWED = 6.0
"""Millimetres that it follows, where models are compared at equal following."""


class Entry(NamedTuple):
    """A model of the table."""

    family: str
    spread: str
    """Whether its size is parameters ("total"), modes of each region ("each") or shapes ("rig")."""
    size: int
    model: FaceModel


class GlobalThenRegions(FaceModel):
    """Modes of the whole face, then region modes of what those leave.

    Parameters
    ----------
    whole : HolisticModel
    rest : RegionModel
        Learned from the frames less what `whole` makes of them.
    """

    def __init__(self, whole, rest):
        self.whole, self.rest = whole, rest

    @property
    def basis(self):
        return np.concatenate([self.whole.basis, self.rest.basis])

    def boundary(self, vertices=None):
        L, n = np.zeros((self.n_coefficients,) * 2), self.whole.n_coefficients
        L[n:, n:] = self.rest.boundary(vertices)
        return L

    def reconstruct(self, X):
        """What it makes of frames, shape (n_frames, 3 * n_vertices)."""
        first = self.whole.reconstruct(X)
        return first + self.rest.reconstruct(X - first)


def stored_components(model):
    """Numbers other than zero that a model stores, in modes of the whole face."""
    if isinstance(model, GlobalThenRegions):
        return stored_components(model.whole) + stored_components(model.rest)
    bases = model.components_ if isinstance(model, RegionModel) else [model.basis]
    return sum(np.count_nonzero(B) for B in bases) / (3 * model.n_vertices)


def rebuilt(model, X):
    """What a model makes of frames, shape (n_frames, 3 * n_vertices); a rig within its bounds."""
    if hasattr(model, "reconstruct"):
        return model.reconstruct(X)
    found = model.displacements(model.encode(X.reshape(len(X), -1, 3)))
    return found.reshape(X.shape)


# --- the models that are compared -----------------------------------------------------------------


def entries(task, sizes=SIZES, each=EACH):
    """Every model of a task, one after another.

    Parameters
    ----------
    task : Task
    sizes : sequence of int
        Parameters in all.
    each : sequence of int
        Modes of each region.

    Yields
    ------
    Entry
    """
    X, regions = task.X, task.regions()
    most = min(len(X) - 1, X.shape[1])
    sizes = [n for n in sizes if n <= most]
    whole = HolisticModel(max((*sizes, *each))).fit(X)
    for n in sizes:
        yield Entry("holistic", "total", n, whole.truncated(n))
        turned = varimax(whole.truncated(n).components_[0])
        yield Entry("rotated", "total", n, RegionModel.from_bases(None, whole.mean_, [turned]))
    for n in each:
        yield Entry("holistic", "each", n, whole.truncated(n))
    split = RegionModel(regions, min(60, most)).fit(X)
    for n in sizes:
        yield Entry("regions", "total", n, split.truncated(n, "total"))
    for n in each:
        yield Entry("regions", "each", n, split.truncated(n))
    first = whole.truncated(GLOBAL)
    rest = RegionModel(regions, min(60, most)).fit(X - first.reconstruct(X))
    for n in (n for n in sizes if n > GLOBAL):
        yield Entry(
            "global, then regions",
            "total",
            n,
            GlobalThenRegions(first, rest.truncated(n - GLOBAL, "total")),
        )
    shrunk = GlobalLocalModel(regions, max(sizes), share=0).fit(X)
    for n in sizes:
        yield Entry("holistic, shrunk", "total", n, shrunk.truncated(n))
    shares = GlobalLocalModel(regions).shares_for(X, sizes)  # as each size would choose by itself
    for share in dict.fromkeys(shares):
        rich = GlobalLocalModel(regions, max(sizes), share).fit(X)
        for n in (n for n, chosen in zip(sizes, shares, strict=True) if chosen == share):
            yield Entry("global and local", "total", n, rich.truncated(n))
    some = X[np.unique(np.linspace(0, len(X) - 1, SPARSE_FRAMES).astype(int))]
    for n in (n for n in sizes if n <= SPARSE_MOST):
        yield Entry("sparse localised", "total", n, localised_model(some, task.mesh, n))
    if task.rig is not None:
        yield Entry("blendshapes", "rig", task.rig.n_coefficients, task.rig)


def error_rows(task, models):
    """Errors of models on all takes of a task: list of dict, a row for each model and take."""
    rows = []
    for family, spread, size, model in models:
        for asked in task.asked:
            made = rebuilt(model, asked.frames)
            rows.append(
                dict(
                    data=task.data,
                    training=task.training,
                    rich="rich" if task.rich else "poor",
                    test=asked.name,
                    model=family,
                    spread=spread,
                    size=size,
                    parameters=model.n_coefficients,
                    components=round(float(stored_components(model)), 2),
                    frames_mm=round(rms_error(asked.frames, made), 4),
                    truth_mm=round(rms_error(asked.truth, made), 4),
                )
            )
    return rows


# --- locality -------------------------------------------------------------------------------------


def pulled(model, mesh, vertex, gamma=GAMMA):
    """What follows when a vertex is pulled by `PULL`.

    Returns
    -------
    followed : float
        How far the vertex goes along the pull, millimetres.
    far : float
        Root mean square motion of the vertices beyond `FAR`, millimetres.
    """
    solver = PoseSolver(model, gamma=gamma, mesh=mesh)
    moved = solver.displacements(solver.solve({vertex: PULL}))[0]
    away = mesh.geodesics([vertex])[0] > FAR
    followed = float(moved[vertex] @ PULL / np.linalg.norm(PULL))
    return followed, float(np.sqrt((moved[away] ** 2).sum(axis=1).mean()))


def pulled_equally(model, mesh, vertex, followed=FOLLOWED):
    """`pulled` at the gamma at which the vertex follows so far: gamma, far; None if at none."""
    low, high = np.log(GAMMAS)
    if pulled(model, mesh, vertex, GAMMAS[0])[0] < followed:
        return None
    for _ in range(16):
        middle = (low + high) / 2
        follows, far = pulled(model, mesh, vertex, np.exp(middle))
        low, high = (middle, high) if follows > followed else (low, middle)
    return float(np.exp(middle)), far


def locality_rows(task, models):
    """How locally models answer a pull at the corner of the mouth: list of dict."""
    rows = []
    for family, spread, size, model in models:
        if size not in LOCAL_SIZES.get(spread, (size,)):
            continue
        followed, far = pulled(model, task.mesh, task.corner)
        equal = pulled_equally(model, task.mesh, task.corner)
        rows.append(
            dict(
                data=task.data,
                training=task.training,
                model=family,
                spread=spread,
                size=size,
                parameters=model.n_coefficients,
                components=round(float(stored_components(model)), 2),
                followed_mm=round(followed, 3),
                far_mm=round(far, 3),
                gamma_equal=None if equal is None else float(f"{equal[0]:.3g}"),
                far_equal_mm=None if equal is None else round(equal[1], 3),
            )
        )
    return rows


# --- all of them ----------------------------------------------------------------------------------


def tasks(progress=True):
    """All tasks that can be made on this machine, and what is missing: generator of Task.

    What cannot be had is said and left out.
    """
    for make in (
        lambda: benchmark_data.actor_tasks(progress=progress),
        benchmark_data.generic_tasks,
        benchmark_data.aura_tasks,
    ):
        try:
            yield from make()
        except data.DataUnavailable as missing:
            print(f"Left out: {missing}")


def run(some, sizes=SIZES, each=EACH, progress=True):
    """Errors of all models on all tasks, and locality on each rich one: two lists of dict.

    Parameters
    ----------
    some : iterable of Task
    sizes, each : sequence of int
        See `entries`.
    progress : bool, default=True
        Show a progress bar.
    """
    errors, locality = [], []
    with tqdm(some, desc="models compared", unit="task", disable=not progress) as bar:
        for task in bar:
            models = list(entries(task, sizes, each))
            errors += error_rows(task, models)
            if task.rich:
                locality += locality_rows(task, models)
    return errors, locality
