"""Ready data: the scanned face of ICT-FaceKit and recorded performances to drive it.

Each is looked for in this order: an argument, an environment variable, the cache; else it is
downloaded once, with checksums. `python -m facelab.datasets` does that ahead of time.
"""

import hashlib
import json
import os
import sys
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import numpy as np
import pooch
from tqdm.auto import tqdm

from facelab.blendshapes import BlendshapeRig
from facelab.errors import check_choice
from facelab.io import load_npz, read_live_link_csv, read_obj, read_obj_vertices, save_npz
from facelab.mesh import MULTI_PIE, TriangleMesh
from facelab.motion import WeightSequence

ICT_URL = "https://raw.githubusercontent.com/ICT-VGL/ICT-FaceKit/da5f95a/FaceXModel/"
ICT_AREAS = {"narrow": (6706, 6560), "face": (9409, 9230), "all": (26719, 26384)}
"""Parts of the ICT mesh: number of vertices and polygons, counted from the first."""

TAKES_URL = (
    "https://raw.githubusercontent.com/alexdjulin/LiveLinkFace-CSV-Retarget-For-Motionbuilder/"
    "122e2b234116f74bf3587c34120698f4a4def9d8/anim/"
)
TAKES = {
    "alex_rom_3": "424bf902b436ee7bcb6dc5ef722e13348cd995e7f6d2e510abdebedfcf1b74f6",
    "alex_rom_4": "985a5699f1384e41155480b32353d53a8851c9dc7598acf3c26187a8dadfb317",
}
"""Recorded performances (one performer, two takes, MIT licence) and their SHA-256."""

_CACHE_VERSION = 1


class DataUnavailable(RuntimeError):
    """Data that is not on this machine and could not be downloaded."""


def cache_dir():
    """Folder for downloaded and made data: `FACELAB_CACHE`, else the user's cache folder."""
    folder = Path(os.environ.get("FACELAB_CACHE") or pooch.os_cache("facelab"))
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _download(url, name, sha256, folder):
    try:
        return Path(
            pooch.retrieve(
                url + name,
                known_hash=f"sha256:{sha256}",
                fname=name,
                path=folder,
                progressbar=False,
            )
        )
    except ValueError as error:  # not a matter of the network: what came is not what was pinned
        raise ValueError(
            f"{name} was downloaded, but is not the file it should be: {error} Try again; if that "
            "does not help, copy the data to this machine and name its folder in FACELAB_ICT or "
            "FACELAB_CAPTURES."
        ) from None
    except Exception as error:  # no network, a server's refusal
        raise DataUnavailable(
            f"{name} is not at hand and could not be downloaded ({type(error).__name__}). "
            "Without a network, copy the data to this machine and name its folder: FACELAB_ICT for "
            "a clone of ICT-FaceKit, FACELAB_CAPTURES for the recorded takes."
        ) from None


def _ict_checksums():
    text = resources.files("facelab").joinpath("ict_sha256.txt").read_text()
    return {name: digest for digest, name in (line.split() for line in text.splitlines())}


def _ict_folder(root):
    """Folder with the ICT files, or None where they must be downloaded."""
    named = root or os.environ.get("FACELAB_ICT")
    if not named:
        return None
    for folder in (Path(named) / "FaceXModel", Path(named)):
        if (folder / "generic_neutral_mesh.obj").is_file():
            return folder
    raise FileNotFoundError(
        f"{'root' if root else 'FACELAB_ICT'}={str(named)!r} holds no FaceXModel/"
        "generic_neutral_mesh.obj; give the folder of a clone of ICT-FaceKit."
    )


def load_ict_facekit(root=None, area="narrow", n_identities=0):
    """The scanned face of ICT-FaceKit: neutral, 68 landmarks, 53 expressions.

    The files are parsed once and kept in the cache.

    Parameters
    ----------
    root : str or Path, optional
        A clone of ICT-FaceKit; else the environment variable `FACELAB_ICT`, the cache, or a
        download of the pinned files (150 MB).
    area : {"narrow", "face", "all"}
        Without ears and neck (6,706 vertices), with them (9,409), or with eyes, teeth and the
        inside of the mouth (26,719).
    n_identities : int, default=0
        Identity modes to load, 0 to 100.

    Returns
    -------
    BlendshapeRig
        Millimetres. Names as in the source (`mouthSmile_L`; left and right are the person's).

    Raises
    ------
    DataUnavailable
        If the files are not on this machine and cannot be downloaded.
    FileNotFoundError, ValueError
        For a folder without the files, an unknown area, damaged files.

    References
    ----------
    Li et al., Learning Formation of Physically-Based Face Attributes, CVPR 2020.
    """
    check_choice(area, "area", tuple(ICT_AREAS))
    if not 0 <= n_identities <= 100:
        raise ValueError(f"n_identities={n_identities}, but ICT-FaceKit has 100: 0 to 100.")
    n_vertices, n_polygons = ICT_AREAS[area]
    data = _ict_arrays(_ict_folder(root), n_identities)
    faces = data["faces"][data["polygon"] < n_polygons]
    landmarks = dict(zip(MULTI_PIE, data["landmarks"].tolist(), strict=True))
    neutral = TriangleMesh(data["neutral"][:n_vertices], faces, landmarks)
    identities = {
        f"identity{i:03d}": shift[:n_vertices] for i, shift in enumerate(data["identities"])
    }
    names = tuple(data["names"].tolist())
    return BlendshapeRig(neutral, names, data["deltas"][:, :n_vertices], identities)


def load_ict_props(root=None):
    """The eyeballs and the inside of the mouth of ICT-FaceKit, to be shown with the face.

    Returns
    -------
    list of (TriangleMesh, colors)
        Millimetres; colors of shape (n_vertices, 3), 0 to 1, chosen here: the source has none.
    """
    head = load_ict_facekit(root, "all").neutral
    mouth = head.submesh(np.arange(11248, 13294))
    props = [(mouth, np.tile((0.28, 0.10, 0.09), (mouth.n_vertices, 1)))]
    mesh = head.submesh(np.arange(21451, 24591))
    for piece in (0, 2):  # the cornea's shell of each eye; the others lie within
        eye = mesh.submesh(mesh.pieces == piece)
        middle = (eye.vertices.min(axis=0) + eye.vertices.max(axis=0)) / 2
        spoke = eye.vertices - middle
        ahead = spoke[np.linalg.norm(spoke, axis=1).argmax()]  # where the cornea bulges
        props.append((eye, _eye_colors(spoke, ahead / np.linalg.norm(ahead), iris=6.6)))
    return props


def _eye_colors(spoke, ahead, iris):
    """White, iris and pupil by distance from the axis of the eye; `iris` is a radius in mm."""
    off_axis = np.linalg.norm(np.cross(spoke, ahead), axis=1)
    off_axis[spoke @ ahead < 0] = np.inf
    colors = np.tile((0.93, 0.92, 0.90), (len(spoke), 1))
    colors[off_axis < iris] = (0.30, 0.22, 0.16)
    colors[off_axis < 0.4 * iris] = (0.03, 0.03, 0.03)
    return colors


def _ict_arrays(folder, n_identities):
    """All of ICT-FaceKit as arrays in millimetres, from the cache if it was parsed before."""
    checksums = _ict_checksums()
    if folder is None:
        stamp = "pinned"
    else:
        about = [(str(f), f.stat().st_size, f.stat().st_mtime_ns) for f in sorted(folder.iterdir())]
        stamp = hashlib.sha256(repr(about).encode()).hexdigest()[:12]
    parsed = cache_dir() / f"ict_{stamp}_{n_identities}.npz"
    if parsed.exists():
        try:
            return load_npz(parsed, "ict-facekit", _CACHE_VERSION)
        except ValueError:
            parsed.unlink()  # half-written or of an older version: made again

    def file(name):
        if folder is None:
            return _download(ICT_URL, name, checksums[name], cache_dir() / "ICT-FaceKit")
        return folder / name

    try:
        index = json.loads(file("vertex_indices.json").read_text())
    except ValueError as error:
        raise ValueError(f"{file('vertex_indices.json')} is damaged ({error}).") from error
    names = index["expressions"]
    shapes = [*names, *(f"identity{i:03d}" for i in range(n_identities))]
    cm_to_mm = 10.0
    mesh = read_obj(file("generic_neutral_mesh.obj"))
    if mesh.n_vertices != ICT_AREAS["all"][0]:
        raise ValueError(
            f"{file('generic_neutral_mesh.obj')} has {mesh.n_vertices} vertices, but ICT-FaceKit "
            f"has {ICT_AREAS['all'][0]}; clone the repository again."
        )
    V = mesh.vertices * cm_to_mm
    deltas = np.empty((len(shapes), len(V), 3), dtype=np.float32)
    for k, name in enumerate(tqdm(shapes, desc="ICT-FaceKit", unit="shape")):
        shape = read_obj_vertices(file(f"{name}.obj"))
        if shape.shape != V.shape:
            raise ValueError(f"{name}.obj has {len(shape)} vertices, the neutral {len(V)}.")
        deltas[k] = shape * cm_to_mm - V
    arrays = dict(
        neutral=V,
        faces=mesh.faces,
        polygon=_polygon_of_each_face(file("generic_neutral_mesh.obj")),
        landmarks=np.array(index["idx_to_landmark_verts"]),
        names=np.array(names),
        deltas=deltas[: len(names)],
        identities=deltas[len(names) :],
    )
    save_npz(parsed, "ict-facekit", _CACHE_VERSION, **arrays)
    return arrays


def _polygon_of_each_face(path):
    """Number of the polygon that each triangle of `read_obj` comes from."""
    corners = [len(line.split()) - 1 for line in path.read_text().splitlines() if line[:2] == "f "]
    return np.repeat(np.arange(len(corners)), np.array(corners) - 2)


def load_take(name, root=None):
    """A recorded performance: 52 ARKit weights in each frame.

    Parameters
    ----------
    name : str
        One of `TAKES`.
    root : str or Path, optional
        Folder with the CSV files; else the environment variable `FACELAB_CAPTURES`, the cache,
        or a download.

    Returns
    -------
    WeightSequence

    Raises
    ------
    ValueError, FileNotFoundError, DataUnavailable
    """
    check_choice(name, "name", tuple(TAKES))
    folder = root or os.environ.get("FACELAB_CAPTURES")
    if folder:
        return read_live_link_csv(Path(folder) / f"{name}.csv")
    return read_live_link_csv(
        _download(TAKES_URL, f"{name}.csv", TAKES[name], cache_dir() / "captures")
    )


def load_capture(actor, size="default", random_state=0, root=None, progress=True):
    """The marker capture of one of the four synthetic actors, made on first use and kept.

    Parameters
    ----------
    actor : {"M1", "F1", "M2", "F2"}
    size : {"default", "small"}
        All takes at 120 frames a second (the largest, M1: 120 MB, half a minute), or a few at
        60 on a coarse mesh, for tests.
    random_state : int, default=0
        All that happens follows from it; the actors' faces and manners do not change.
    root : str or Path, optional
        Where it is kept; else `cache_dir()`. One that is incomplete, damaged or out of date is
        made again.
    progress : bool, default=True
        Show a progress bar while it is made.

    Returns
    -------
    data_synth.capture.Capture
        Its `takes` names the takes; `markers(take)` is what was captured, `truth(take)` and
        `surface(take)` are what lies behind it.

    Raises
    ------
    ValueError, TypeError
        For an unknown actor or size, or a seed that is no integer of 0 or more.
    """
    from data_synth.capture import open_capture  # the one place where facelab asks for the actors

    return open_capture(actor, root or cache_dir(), size, random_state, progress)


def load_template(n_vertices=8820):
    """The face that is fitted to all others: the average of the synthetic ones, with landmarks.

    Parameters
    ----------
    n_vertices : int, default=8820
        8,820 as in Tena et al., or 4,375 as in Yu and Liu.

    Returns
    -------
    TriangleMesh
        Millimetres, head frame.
    """
    from data_synth.template import build_template

    face = build_template(n_vertices=n_vertices)
    return TriangleMesh(
        face.vertices, face.faces, dict(zip(MULTI_PIE, face.landmarks.tolist(), strict=True))
    )


@dataclass(frozen=True)
class Example:
    """A face with motion to learn from and motion to be tested on.

    Parameters
    ----------
    about : str
        What it is, real or synthetic, in a sentence.
    rig : BlendshapeRig
    train, test : WeightSequence
        Two takes of one performer.
    props : list of (TriangleMesh, colors)
        Still parts to show with the face: eyes, the inside of the mouth.
    """

    about: str
    rig: BlendshapeRig
    train: WeightSequence
    test: WeightSequence
    props: list = field(repr=False)


def load_example():
    """The scanned face and two recorded takes, or a synthetic actor where they are not at hand.

    Returns
    -------
    Example
    """
    try:
        rig, props = load_ict_facekit(), load_ict_props()
        train, test = (load_take(name) for name in TAKES)
    except DataUnavailable as missing:
        return _synthetic_example(str(missing))
    about = (
        "REAL data: the scanned face of ICT-FaceKit, moved by two recorded takes of one performer "
        "(alex_rom_3 to learn from, alex_rom_4 to test)."
    )
    return Example(about, rig, train, test, props)


def synthetic_props(face):
    """The eyes and the dark of the mouth of a synthetic face, to be shown with it.

    Parameters
    ----------
    face : data_synth.template.Template

    Returns
    -------
    list of (TriangleMesh, colors)
        Millimetres; colors of shape (n_vertices, 3), 0 to 1. Only the front of the eyeballs.
    """
    import trimesh

    ball = trimesh.creation.icosphere(4)
    front = TriangleMesh(ball.vertices, ball.faces).submesh(ball.vertices[:, 2] > 0.3)
    props = []
    for centre, radius in face.eyeballs.values():
        spoke = radius * front.vertices
        colors = _eye_colors(spoke, np.array([0.0, 0.0, 1.0]), iris=5.9)
        # a little back: lids drawn triangle by triangle would let the white through
        props.append((front.with_vertices(centre + spoke - [0, 0, 0.6]), colors))
    lips = face.vertices[face.landmarks[MULTI_PIE.index("mouth_inner_upper")]]
    # bulging, so that its rim stays inside the cheeks when the jaw drops
    dark = front.with_vertices(lips + [0, -11, -60] + front.vertices * [36, 32, 36])
    return [*props, (dark, np.tile((0.28, 0.10, 0.09), (dark.n_vertices, 1)))]


def _synthetic_example(why):
    """Actor M1 of `data_synth`: a range of motion to learn from, sentences to be tested on."""
    from data_synth.action_units import actor_rig
    from data_synth.performance import SENTENCES, perform_rom, perform_sentence

    rig = actor_rig("M1")
    spoken = [perform_sentence("M1", name, fps=30).weights for name in list(SENTENCES)[:12]]
    test = WeightSequence(np.concatenate([s.weights for s in spoken]), rig.names, 30)
    about = (
        "SYNTHETIC data: actor M1 of data_synth, a face made by code, with performed motion. "
        f"(Real data: {why})"
    )
    props = synthetic_props(rig.template)
    return Example(about, rig.linear(), perform_rom("M1", fps=30).weights, test, props)


def main():
    """Fetch and prepare what the notebooks use; say plainly what is not to be had."""
    try:
        rig = load_ict_facekit()
        takes = [load_take(name) for name in TAKES]
        print(f"real face: {rig}; real motion: {', '.join(map(repr, takes))}")
    except DataUnavailable as missing:
        print(f"Real data is not at hand: {missing}", file=sys.stderr)
        print("The lab runs on synthetic faces instead.", file=sys.stderr)


if __name__ == "__main__":
    main()
