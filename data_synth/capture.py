"""What a capture system sees of the four actors: markers in motion, with its faults.

A capture is a folder per actor: one C3D file for each take, and beside them the truth from which
they were made: weights, head pose, marker sites, faults and seed. Dense surfaces are rebuilt from
it on demand; all of them would be gigabytes.
"""

import functools
import hashlib
import json
import os
import shutil
import tempfile
import time
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from threadpoolctl import ThreadpoolController
from tqdm.auto import tqdm

from data_synth.actors import ACTORS, actor_number
from data_synth.performance import (
    N_FACS,
    NECK,
    SENTENCES,
    perform_facs,
    perform_rom,
    perform_sentence,
)
from data_synth.units import UNITS
from facelab.checks import check_choice
from facelab.files import read_c3d, write_c3d
from facelab.geometry.mesh import TriangleMesh
from facelab.motion import MarkerSequence, WeightSequence
from facelab.storage import load_npz, save_npz

_threads = ThreadpoolController()

VERSION = 1
"""Layout of a capture folder."""

RADIUS = 1.5
"""Height of a marker's centre over the skin, millimetres: markers are 3 mm wide."""


class Rig(Protocol):
    """What a capture needs of an actor's face."""

    names: tuple
    neutral: TriangleMesh

    def animate(self, weights, vertices=None):
        """Positions (n_frames, n, 3) at weights (n_frames, 40), of some vertices or of all."""


class Size(NamedTuple):
    """How much of everything a capture holds."""

    fps: float
    n_vertices: int
    sentences: tuple
    rom_seconds: float
    n_facs: int


SIZES = {
    "default": Size(120.0, 8820, tuple(SENTENCES), 84.0, N_FACS),
    "small": Size(60.0, 3000, tuple(s for s in SENTENCES if s[-1] in "15"), 5.0, 4),
}
"""All of it; or one training and one test sentence of each emotion on a coarse mesh, for tests."""

_ALWAYS = (
    "chin", "jaw_right_3", "jaw_left_3", "jaw_right_6", "jaw_left_6", "brow_right_1",
    "brow_right_3", "brow_right_5", "brow_left_5", "brow_left_3", "brow_left_1", "nose_bridge_1",
    "nose_bridge_3", "nose_tip", "nostril_right_outer", "nostril_left_outer", "nose_base",
    "mouth_corner_right", "mouth_corner_left", "lip_upper", "lip_lower",
)  # fmt: skip
_SOMETIMES = (
    "jaw_right_4", "jaw_left_4", "jaw_right_8", "jaw_left_8", "brow_right_2", "brow_left_2",
    "brow_right_4", "brow_left_4", "lip_upper_right_outer", "lip_upper_left_outer",
    "lip_lower_right_outer", "lip_lower_left_outer", "nose_bridge_2",
)  # fmt: skip
_OFTEN_HIDDEN = ("chin", "mouth_corner_right", "mouth_corner_left", "lip_lower", "nose_base",
                 "jaw_right_6", "jaw_left_6", "jaw_right_8", "jaw_left_8")  # fmt: skip


# --- where the markers sit ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Sites:
    """Feet of the markers on the skin.

    Parameters
    ----------
    names : tuple of str
        A landmark of `facelab.mesh.MULTI_PIE`, or m001, m002, ... from the top down.
    faces : ndarray of int, shape (n_markers,)
        Triangle that each marker is glued to.
    weights : ndarray of shape (n_markers, 3)
        Barycentric place in that triangle; each row sums to 1.
    """

    names: tuple
    faces: np.ndarray
    weights: np.ndarray

    def feet_and_normals(self, corners):
        """Points on the skin and unit normals of the triangles there.

        Parameters
        ----------
        corners : ndarray of shape (n_frames, n_markers, 3, 3)
            Positions of the three corners of each marker's triangle, millimetres.

        Returns
        -------
        feet, normals : ndarray of shape (n_frames, n_markers, 3)
        """
        feet = np.einsum("fmcx,mc->fmx", corners, self.weights)
        a, b, c = np.moveaxis(corners, 2, 0)
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        return feet, normals / np.maximum(length, 1e-12)


def _contour(mesh, names):
    """A closed smooth line through landmarks, shape (200, 3)."""
    points = mesh.vertices[[mesh.landmarks[n] for n in names]]
    points = np.vstack([points, points[:1]])
    along = np.append(0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return CubicSpline(along, points, bc_type="periodic")(np.linspace(0, along[-1], 200))


def contours(mesh):
    """Lid margins and the line where the lips meet, as closed lines: dict of (200, 3) arrays."""
    eye = ("outer", "upper_outer", "upper_inner", "inner", "lower_inner", "lower_outer")
    mouth = ("right", "upper_right", "upper", "upper_left", "left", "lower_left", "lower",
             "lower_right")  # fmt: skip
    return {
        "eye_right": _contour(mesh, [f"eye_right_{e}" for e in eye]),
        "eye_left": _contour(mesh, [f"eye_left_{e}" for e in eye]),
        "mouth": _contour(mesh, [f"mouth_inner_{m}" for m in mouth]),
    }


def _within(points, line):
    """Whether points (n, 3) lie inside a closed line seen from the front, (n,)."""
    x, y = points[:, 0, None], points[:, 1, None]
    x0, y0 = line[:-1, 0], line[:-1, 1]
    x1, y1 = line[1:, 0], line[1:, 1]
    rise = np.where(y1 == y0, 1.0, y1 - y0)
    hit = ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * (y - y0) / rise + x0)
    return hit.sum(axis=1) % 2 == 1


def _free_skin(mesh, points, normals):
    """Where a marker may be glued: mask (n,) of points (n, 3) with their normals."""
    free = np.ones(len(points), dtype=bool)
    for name, line in contours(mesh).items():
        margin = 4.5 if name != "mouth" else 3.0  # mm; lids and lips must be able to close
        free &= (cKDTree(line).query(points)[0] > margin) & ~_within(points, line)
    # no camera sees under the jaw, behind the cheek or into the nostrils
    free &= (normals[:, 2] > 0.3) & (normals[:, 1] > -0.75)
    nostrils = [mesh.landmarks[f"nostril_{s}_{p}"] for s in ("right", "left") for p in ("inner",)]
    free &= cKDTree(mesh.vertices[nostrils]).query(points)[0] > 6.0
    if mesh.boundary_loops:
        free &= cKDTree(mesh.vertices[mesh.boundary_loops[0]]).query(points)[0] > 5.0
    return free


@_threads.wrap(limits=1)  # as in the template: choices between equals hang on the last digit
def place_markers(mesh, spacing=11.5, random_state=0):
    """Markers about `spacing` apart, those on landmarks first.

    Parameters
    ----------
    mesh : TriangleMesh
        A neutral face with the landmarks of `facelab.mesh.MULTI_PIE`.
    spacing : float, default=11.5
        Millimetres to the nearest neighbour on average; no two of the free markers, nor one of
        them and one on a landmark, are closer than 0.92 of it.
    random_state : int or sequence of int

    Returns
    -------
    Sites
        21 or more on landmarks; none near a lid's edge, inside the lips, in a nostril or where
        no camera looks.
    """
    rng = np.random.default_rng(random_state)
    V, F = mesh.vertices, mesh.faces
    wanted = [*_ALWAYS, *(n for n in _SOMETIMES if rng.random() < 0.55)]
    names, faces, weights, points = [], [], [], np.empty((0, 3))
    for name in wanted:
        vertex = mesh.landmarks[name]
        if len(points) and np.linalg.norm(points - V[vertex], axis=1).min() < 0.6 * spacing:
            continue
        around = np.flatnonzero((F == vertex).any(axis=1))
        face = int(around[rng.integers(len(around))])
        away = rng.uniform(0, 0.15, 2)  # nobody glues a marker exactly
        w = np.where(F[face] == vertex, 1 - away.sum(), 0.0)
        w[F[face] != vertex] = away
        names.append(name)
        faces.append(face)
        weights.append(w)
        points = np.vstack([points, w @ V[F[face]]])
    # free ones: darts thrown evenly at the skin, kept where no other is near
    count = 60 * int(mesh.face_areas.sum() / spacing**2)
    face = rng.choice(len(F), count, p=mesh.face_areas / mesh.face_areas.sum())
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    w = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    darts = np.einsum("nc,ncx->nx", w, V[F[face]])
    ok = _free_skin(mesh, darts, np.einsum("nc,ncx->nx", w, mesh.normals[F[face]]))
    ok &= cKDTree(points).query(darts)[0] >= 0.92 * spacing
    kept = []
    near = cKDTree(darts)
    for i in range(count):
        if ok[i]:
            kept.append(i)
            ok[near.query_ball_point(darts[i], 0.92 * spacing)] = False
    kept = np.array(kept)[np.argsort(-darts[kept, 1])]
    return Sites(
        (*names, *(f"m{i + 1:03d}" for i in range(len(kept)))),
        np.append(faces, face[kept]).astype(int),
        np.vstack([weights, w[kept]]),
    )


# --- what the cameras make of it ------------------------------------------------------------------


class Swap(NamedTuple):
    """Two markers exchange their names in the frames first to stop - 1."""

    first: int
    stop: int
    a: str
    b: str


class Ghost(NamedTuple):
    """A marker that is not there, seen in the frames first to stop - 1."""

    first: int
    stop: int
    name: str


@dataclass(frozen=True, eq=False)
class Truth:
    """What lies behind the markers of one take.

    Parameters
    ----------
    weights : WeightSequence
        Of the forty action units.
    rotation : ndarray of shape (n_frames, 3, 3)
    translation : ndarray of shape (n_frames, 3)
        Head pose: a point x of the head frame is seen at rotation @ x + translation,
        millimetres.
    sites : Sites
    noise : ndarray of shape (3,)
        Standard deviation on each axis of the capture frame, millimetres.
    swaps : tuple of Swap
    ghosts : tuple of Ghost
    random_state : int
        The seed that all of it follows from.
    """

    weights: WeightSequence
    rotation: np.ndarray = field(repr=False)
    translation: np.ndarray = field(repr=False)
    sites: Sites = field(repr=False)
    noise: np.ndarray
    swaps: tuple
    ghosts: tuple
    random_state: int


def _seat(actor, random_state):
    """Where and how the actor sits in the capture volume: rotation and place of the neck."""
    rng = np.random.default_rng([random_state, 5, actor_number(actor)])
    yaw, roll = rng.uniform(-8, 8), rng.uniform(-1.5, 1.5)
    turn = Rotation.from_euler("YZ", [yaw, roll], degrees=True)
    return turn, np.array([rng.uniform(-150, 150), rng.uniform(1150, 1250), rng.uniform(-150, 150)])


def _pose(performance, random_state):
    """Rotation (F, 3, 3) and translation (F, 3) from the head frame to the capture volume."""
    turn, place = _seat(performance.actor, random_state)
    rotation = turn * Rotation.from_rotvec(performance.rotation)
    translation = place + turn.apply(performance.sway) - rotation.apply(NECK)
    return rotation.as_matrix(), translation


def _bursts(rng, hazard, share, fps, seconds=0.12):
    """Occlusions that come in bursts: mask like `hazard`, the mean of which is about `share`."""
    n_frames = len(hazard)
    mean = max(seconds * fps, 1.0)
    start = rng.random(hazard.shape) < np.minimum(share / mean * hazard / hazard.mean(), 0.5)
    frame, marker = np.nonzero(start)
    stop = np.minimum(frame + rng.geometric(1 / mean, len(frame)), n_frames)
    steps = np.zeros((n_frames + 1, hazard.shape[1]), dtype=int)
    np.add.at(steps, (frame, marker), 1)
    np.add.at(steps, (stop, marker), -1)
    return np.cumsum(steps[:-1], axis=0) > 0


def _intervals(rng, n_frames, fps, per_second, shortest, longest):
    """Short intervals at random: list of (first, stop) frames."""
    found = []
    for _ in range(rng.poisson(per_second * n_frames / fps)):
        length = max(2, round(rng.uniform(shortest, longest) * fps))
        if length < n_frames:
            first = int(rng.integers(n_frames - length))
            found.append((first, first + length))
    return sorted(found)


def _draw_swaps(rng, sites, feet, n_frames, fps):
    pairs = sorted(cKDTree(feet).query_pairs(15.0))
    swaps = []
    for first, stop in _intervals(rng, n_frames, fps, 0.10, 0.05, 0.30):
        a, b = (sites.names[i] for i in pairs[rng.integers(len(pairs))])
        busy = {n for s in swaps if s.first < stop and first < s.stop for n in (s.a, s.b)}
        if not busy & {a, b}:
            swaps.append(Swap(first, stop, a, b))
    return tuple(swaps)


def _draw_ghosts(rng, n_frames, fps):
    ghosts = []
    for first, stop in _intervals(rng, n_frames, fps, 0.15, 0.03, 0.25):
        number = 1  # the lowest that no other ghost has at that time
        while any(g.stop > first and g.name == f"ghost{number}" for g in ghosts):
            number += 1
        ghosts.append(Ghost(first, stop, f"ghost{number}"))
    return tuple(ghosts)


def _spoil(clean, normals, sites, feet, actor, fps, seed):
    """Positions as measured and what was done to them: (positions, names, swaps, ghosts)."""
    # a stream for each fault, so that one more marker does not change all of them
    rng, swapping, haunting = (np.random.default_rng([*seed, i]) for i in range(3))
    markers = ACTORS[actor].markers
    n_frames = len(clean)
    seen = clean + rng.normal(size=clean.shape) * markers.noise
    often = np.array([2.5 if n in _OFTEN_HIDDEN else 1.0 for n in sites.names])
    low = feet[:, 1] < np.interp(0.3, [0, 1], [feet[:, 1].min(), feet[:, 1].max()])
    hazard = np.where(low, 1.6, 1.0) * often * np.exp(-2.5 * normals[..., 2])
    hidden = _bursts(rng, hazard, markers.occluded, fps)
    seen[hidden] = np.nan
    swaps = _draw_swaps(swapping, sites, feet, n_frames, fps)
    for first, stop, a, b in swaps:
        i, j = sites.names.index(a), sites.names.index(b)
        seen[first:stop, [i, j]] = seen[first:stop, [j, i]]
    ghosts = _draw_ghosts(haunting, n_frames, fps)
    extra = tuple(sorted({g.name for g in ghosts}, key=lambda n: int(n[5:])))
    columns = np.full((n_frames, len(extra), 3), np.nan)
    for first, stop, name in ghosts:
        near = clean[first:stop, haunting.integers(clean.shape[1])]
        aside = haunting.normal(size=3)
        aside *= haunting.uniform(5, 25) / np.linalg.norm(aside)
        drift = np.linspace(0, 1, stop - first)[:, None] * haunting.normal(0, 4, 3)
        columns[first:stop, extra.index(name)] = near + aside + drift
    return np.concatenate([seen, columns], axis=1), (*sites.names, *extra), swaps, ghosts


def _true_markers(rig, sites, weights, rotation, translation, chunk=512):
    """Marker centres (F, M, 3) and skin normals in the capture volume, without any fault."""
    corners = rig.neutral.faces[sites.faces]
    vertices, place = np.unique(corners, return_inverse=True)
    place = place.reshape(corners.shape)
    centres = np.empty((len(weights), len(corners), 3))
    normals = np.empty_like(centres)
    for first in range(0, len(weights), chunk):
        part = slice(first, first + chunk)
        skin = np.asarray(rig.animate(weights[part], vertices=vertices), dtype=float)
        feet, out = sites.feet_and_normals(skin[:, place])
        R = rotation[part]
        centres[part] = np.einsum("fxy,fmy->fmx", R, feet + RADIUS * out)
        centres[part] += translation[part, None]
        normals[part] = np.einsum("fxy,fmy->fmx", R, out)
    return centres, normals


# --- making a capture -----------------------------------------------------------------------------


def actor_rig(actor, n_vertices=8820):
    """The face and action units of an actor, as a capture uses them."""
    from data_synth import action_units

    return action_units.actor_rig(actor, n_vertices=n_vertices)


def _performances(actor, size, random_state):
    """All takes of an actor, one by one: functions that perform them, by name."""
    takes = {
        name: lambda name=name: perform_sentence(actor, name, size.fps, random_state)
        for name in size.sentences
    }
    if ACTORS[actor].all_units:
        takes["rom"] = lambda: perform_rom(actor, size.fps, random_state, size.rom_seconds)
        # spread over the list, so that few of them still hold single units and combinations
        for number in np.linspace(1, N_FACS, size.n_facs).round().astype(int).tolist():
            takes[f"facs_{number:02d}"] = lambda number=number: perform_facs(
                actor, number, size.fps, random_state
            )
    return takes


@functools.cache
def code_stamp():
    """Fingerprint of the code that makes the actors; a capture made by other code is stale."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


code_stamp()  # of the code as it is imported: the files may be edited while it runs


def _sha256(path):
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check(actor, size, random_state):
    check_choice(actor, "actor", tuple(ACTORS))
    check_choice(size, "size", tuple(SIZES))
    if isinstance(random_state, bool) or not isinstance(random_state, (int, np.integer)):
        raise TypeError(f"random_state={random_state!r} is not an integer.")
    if random_state < 0:
        raise ValueError(f"random_state={random_state}, but it must be 0 or more.")


def make_capture(actor, folder, size="default", random_state=0, rig=None, progress=True):
    """Make the capture of one actor, whole or not at all.

    Parameters
    ----------
    actor : str
        One of `data_synth.performance.ACTORS`.
    folder : str or Path
        Made under another name first, renamed when whole. Must not exist yet, or be empty.
    size : {"default", "small"}
    random_state : int, default=0
        All that happens follows from it; the actors' faces and manners do not change.
    rig : Rig, optional
        The actor's face; built if left out.
    progress : bool, default=True
        Show a progress bar.

    Returns
    -------
    Capture

    Raises
    ------
    ValueError, TypeError
        For an unknown actor or size, or a seed that is no integer of 0 or more.
    FileExistsError
        If the folder holds something already.
    """
    _check(actor, size, random_state)
    folder = Path(folder)
    if folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"folder={str(folder)!r} holds something already; name another one.")
    folder.parent.mkdir(parents=True, exist_ok=True)
    _sweep(folder.parent)
    part = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".part", dir=folder.parent))
    try:
        rig = actor_rig(actor, SIZES[size].n_vertices) if rig is None else rig
        _fill(part, actor, size, int(random_state), rig, progress)
        umask = os.umask(0)
        os.umask(umask)
        part.chmod(0o777 & ~umask)
        if folder.exists():
            folder.rmdir()
        part.rename(folder)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    return Capture(folder, rig)


def _sweep(folder, hours=6):
    """Remove what killed runs left behind; younger ones may still be at work."""
    for part in folder.glob(".*.part"):
        if time.time() - part.stat().st_mtime > 3600 * hours:
            shutil.rmtree(part, ignore_errors=True)


def _fill(folder, actor, size, random_state, rig, progress):
    """Write all files of a capture into a folder."""
    if tuple(rig.names) != UNITS:
        raise ValueError(
            f"rig.names is {', '.join(rig.names)}, but must be the forty units in their order: "
            f"{', '.join(UNITS)}."
        )
    markers = ACTORS[actor].markers
    seed = [random_state, 6, actor_number(actor)]
    sites = place_markers(rig.neutral, markers.spacing, seed)
    neutral = rig.neutral.vertices[rig.neutral.faces[sites.faces]][None]
    feet = sites.feet_and_normals(neutral)[0][0]
    takes = _performances(actor, SIZES[size], random_state)
    stored = {
        "site_names": sites.names, "site_faces": sites.faces, "site_weights": sites.weights,
        "noise": markers.noise,
    }  # fmt: skip
    about = {}
    bar = tqdm(takes.items(), desc=f"{actor}: capture", unit="take", disable=not progress)
    for number, (name, perform) in enumerate(bar):
        performance = perform()
        W = performance.weights.weights
        rotation, translation = _pose(performance, random_state)
        clean, normals = _true_markers(rig, sites, W, rotation, translation)
        seen, names, swaps, ghosts = _spoil(
            clean, normals, sites, feet, actor, performance.weights.fps, [*seed, number]
        )
        measured = MarkerSequence(seen.astype(np.float32), names, performance.weights.fps)
        write_c3d(folder / f"{name}.c3d", measured)
        about[name] = {
            "text": performance.text, "n_frames": len(W), "fps": performance.weights.fps,
            "swaps": swaps, "ghosts": ghosts,
        }  # fmt: skip
        stored[f"{name}.weights"] = W.astype(np.float32)
        stored[f"{name}.rotation"] = rotation
        stored[f"{name}.translation"] = translation
        for angle, values in performance.weights.angles.items():
            stored[f"{name}.{angle}"] = values
    save_npz(folder / "truth.npz", "data_synth-truth", VERSION, **stored)
    files = {f.name: _sha256(f) for f in sorted(folder.iterdir())}
    manifest = {
        "version": VERSION, "code": code_stamp(), "actor": actor, "size": size,
        "random_state": random_state, "n_markers": len(sites.names), "takes": about,
        "files": files,
    }  # fmt: skip
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1))


def open_capture(actor, root, size="default", random_state=0, progress=True):
    """The capture of one actor from a cache, made on first use.

    Parameters
    ----------
    actor : str
    root : str or Path
        The cache. The capture stands in `data_synth-<version>-<size>-<random_state>/<actor>`;
        one that is incomplete, damaged, or made by other code is made again.
    size : {"default", "small"}
    random_state : int, default=0
    progress : bool, default=True

    Returns
    -------
    Capture
    """
    _check(actor, size, random_state)
    folder = Path(root) / f"data_synth-{VERSION}-{size}-{random_state}" / actor
    wanted = {
        "version": VERSION, "code": code_stamp(), "actor": actor, "size": size,
        "random_state": int(random_state),
    }  # fmt: skip
    if fault(folder, wanted) is not None:
        if folder.exists():
            stale = Path(tempfile.mkdtemp(prefix=f".{actor}.", suffix=".part", dir=folder.parent))
            folder.rename(stale / actor)
            shutil.rmtree(stale, ignore_errors=True)
        try:
            return make_capture(actor, folder, size, random_state, progress=progress)
        except OSError:  # another process made it meanwhile: then it is there, and whole
            if fault(folder, wanted) is not None:
                raise
    return Capture(folder)


def fault(folder, wanted=None):
    """What is wrong with a capture folder, in words; None if it is whole.

    Parameters
    ----------
    folder : str or Path
    wanted : dict, optional
        Entries that its manifest must have.
    """
    folder = Path(folder)
    try:
        manifest = json.loads((folder / "manifest.json").read_text())
        files = dict(manifest["files"])
        differs = [k for k, v in (wanted or {}).items() if manifest.get(k) != v]
    except FileNotFoundError:
        return "it has no manifest"
    except (OSError, ValueError, KeyError, TypeError) as error:
        return f"its manifest is damaged ({type(error).__name__})"
    if differs:
        return f"it was made with another {', '.join(differs)}"
    missing = [name for name in files if not (folder / name).is_file()]
    if missing:
        return f"{', '.join(missing)} missing"
    changed = [name for name, digest in files.items() if _sha256(folder / name) != digest]
    return f"{', '.join(changed)} damaged" if changed else None


# --- using a capture ------------------------------------------------------------------------------


class Capture:
    """The recorded takes of one actor, and the truth behind them.

    Parameters
    ----------
    folder : str or Path
        Made by `make_capture` or `open_capture`.
    rig : Rig, optional
        The actor's face; built when first needed if left out.

    Raises
    ------
    ValueError
        If the folder is incomplete or damaged.

    Attributes
    ----------
    actor, size, random_state : str, str, int
    takes : dict of str to tuple of str
        Names of the takes by kind: `train` and `test` sentences, `rom`, `facs`.
    texts : dict of str to str
        What is said or shown in each take.
    """

    def __init__(self, folder, rig=None):
        self.folder = Path(folder)
        wrong = fault(self.folder)
        if wrong is not None:
            raise ValueError(f"folder={str(folder)!r} holds no whole capture: {wrong}.")
        self._about = json.loads((self.folder / "manifest.json").read_text())
        self.actor, self.size = self._about["actor"], self._about["size"]
        self.random_state = self._about["random_state"]
        self.texts = {name: about["text"] for name, about in self._about["takes"].items()}
        self.takes = {"train": (), "test": (), "rom": (), "facs": ()}
        for name in self.texts:
            kind = SENTENCES[name].split if name in SENTENCES else name.split("_")[0]
            self.takes[kind] += (name,)
        self._given_rig = rig

    def __repr__(self):
        counts = ", ".join(f"{len(names)} {kind}" for kind, names in self.takes.items() if names)
        frames = sum(about["n_frames"] for about in self._about["takes"].values())
        return (
            f"Capture({self.actor}: {self._about['n_markers']} markers, {counts} takes, "
            f"{frames} frames; random_state={self.random_state})"
        )

    @cached_property
    def rig(self):
        """The actor's face with its forty action units.

        Raises
        ------
        ValueError
            If the code that makes the faces has changed since the capture: the skin would not
            be the one that wore the markers.
        """
        if self._given_rig is not None:
            return self._given_rig
        if self._about["code"] != code_stamp():
            raise ValueError(
                f"{self.folder} was made by another version of data_synth, whose faces cannot be "
                "rebuilt by this one; make the capture again."
            )
        return actor_rig(self.actor, SIZES[self.size].n_vertices)

    @property
    def neutral(self):
        """The actor's face at rest: TriangleMesh, head frame."""
        return self.rig.neutral

    @cached_property
    def _stored(self):
        return load_npz(self.folder / "truth.npz", "data_synth-truth", VERSION)

    @cached_property
    def sites(self):
        """Where the markers are glued: Sites."""
        s = self._stored
        return Sites(tuple(s["site_names"].tolist()), s["site_faces"], s["site_weights"])

    def path(self, take):
        """The C3D file of a take, for other tools."""
        check_choice(take, "take", tuple(self.texts))
        return self.folder / f"{take}.c3d"

    def markers(self, take):
        """What the capture system delivers of a take.

        Parameters
        ----------
        take : str
            One of those in `takes`.

        Returns
        -------
        MarkerSequence
            Millimetres, capture frame; noisy, with gaps, swaps and ghosts.

        Raises
        ------
        ValueError
            For an unknown take; the message lists those there are.
        """
        return read_c3d(self.path(take))  # its checksum was verified

    def truth(self, take):
        """What lies behind the markers of a take: Truth."""
        check_choice(take, "take", tuple(self.texts))
        about, s = self._about["takes"][take], self._stored
        angles = {a: s[f"{take}.{a}"] for a in ("HeadYaw", "HeadPitch", "HeadRoll")}
        return Truth(
            WeightSequence(s[f"{take}.weights"].astype(float), UNITS, about["fps"], angles=angles),
            s[f"{take}.rotation"],
            s[f"{take}.translation"],
            self.sites,
            s["noise"],
            tuple(Swap(*swap) for swap in about["swaps"]),
            tuple(Ghost(*ghost) for ghost in about["ghosts"]),
            self.random_state,
        )

    def true_markers(self, take):
        """The markers of a take without noise, gaps, swaps and ghosts: MarkerSequence."""
        truth = self.truth(take)
        centres, _ = _true_markers(
            self.rig, self.sites, truth.weights.weights, truth.rotation, truth.translation
        )
        return MarkerSequence(centres, self.sites.names, truth.weights.fps)

    def surface(self, take, frames=None, vertices=None):
        """The skin itself in some frames of a take, rebuilt from the weights.

        Parameters
        ----------
        take : str
        frames : slice or array_like of int, optional
            All of them if left out.
        vertices : array_like of int, optional
            Vertices of `neutral`; all of them if left out.

        Returns
        -------
        positions : ndarray of float32, shape (n_frames, n_vertices, 3)
            Millimetres, head frame: the head's motion is not in them.

        Raises
        ------
        ValueError
            For an unknown take, frames or vertices that do not exist, or more than 2 GiB.
        """
        weights = self.truth(take).weights.weights
        weights = weights[
            _picked(slice(None) if frames is None else frames, len(weights), "frames")
        ]
        n = self.neutral.n_vertices
        if vertices is not None:
            vertices = np.arange(n)[_picked(vertices, n, "vertices")]
            n = len(vertices)
        if len(weights) * n * 12 > 2**31:
            gigabytes = len(weights) * n * 12 / 2**30
            raise ValueError(
                f"{len(weights)} frames of {n} vertices are {gigabytes:.1f} GiB; ask for fewer "
                "frames or vertices at a time."
            )
        positions = np.empty((len(weights), n, 3), dtype=np.float32)
        for first in range(0, len(weights), 64):
            part = slice(first, first + 64)
            positions[part] = self.rig.animate(weights[part], vertices=vertices)
        return positions


def _picked(index, size, name):
    """A slice as it is, or indices that are sure to exist."""
    if isinstance(index, slice):
        return index
    index = np.atleast_1d(index)
    if index.dtype.kind not in "iu" or index.ndim != 1:
        raise TypeError(f"{name} must be a slice or a list of integers.")
    bad = index[(index < 0) | (index >= size)]
    if bad.size:
        raise ValueError(f"{name} holds {bad[0]}, but there are {size}: 0 to {size - 1}.")
    return index
