"""The takes of an actor, recorded: performed, seen by the cameras, written to files."""

import json
from contextlib import closing
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from tqdm.auto import tqdm

from data_synth.actors import ACTORS, actor_number
from data_synth.capture.faults import spoil
from data_synth.capture.sites import place_markers
from data_synth.performance import (
    N_FACS,
    NECK,
    SENTENCES,
    perform_facs,
    perform_rom,
    perform_sentence,
)
from data_synth.units import UNITS
from facelab.files.markers.c3d_write import write_c3d
from facelab.motion import MarkerSequence
from facelab.numeric.threads import side_by_side
from facelab.storage import save_npz

VERSION = 2
"""Layout of a capture folder."""

RADIUS = 1.5
"""Height of a marker's centre over the skin, millimetres: markers are 3 mm wide."""


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


def true_markers(rig, sites, weights, rotation, translation, chunk=512):
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


def record(folder, actor, size, random_state, rig, progress):
    """Write all files of a capture into a folder.

    Raises
    ------
    ValueError
        If the rig has other units than the forty.
    OSError
        If a file could not be written whole.
    """
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
    truth = {
        "site_names": sites.names, "site_faces": sites.faces, "site_weights": sites.weights,
        "noise": markers.noise,
    }  # fmt: skip

    def recorded(numbered):
        number, name = numbered
        performance = takes[name]()
        W, fps = performance.weights.weights, performance.weights.fps
        rotation, translation = _pose(performance, random_state)
        clean, normals = true_markers(rig, sites, W, rotation, translation)
        seen, names, swaps, ghosts = spoil(
            clean, normals, sites, feet, markers, fps, [*seed, number]
        )
        write_c3d(folder / f"{name}.c3d", MarkerSequence(seen.astype(np.float32), names, fps))
        said = {
            "text": performance.text, "n_frames": len(W), "fps": fps, "swaps": swaps,
            "ghosts": ghosts,
        }  # fmt: skip
        true = {"weights": W.astype(np.float32), "rotation": rotation, "translation": translation}
        return name, said, true | performance.weights.angles

    about = {}
    with closing(side_by_side(recorded, list(enumerate(takes)))) as found:
        bar = tqdm(found, f"{actor}: capture", len(takes), unit="take", disable=not progress)
        for name, said, true in bar:
            about[name] = said
            truth |= {f"{name}.{what}": values for what, values in true.items()}
    save_npz(folder / "truth.npz", "data_synth-truth", 1, **truth)
    about = {"n_markers": len(sites.names), "takes": about}
    (folder / "takes.json").write_text(json.dumps(about, indent=1))
