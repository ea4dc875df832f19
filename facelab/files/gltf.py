"""Faces with morph targets and animation as GLB, the binary form of glTF 2.0.

glTF counts in metres, y up, z towards the viewer: the head frame in another unit.
"""

import numpy as np

from facelab.checks import as_finite, check_choice, check_count, check_type
from facelab.files.gltf_write import ARRAY, ELEMENTS, GltfPieces, glb_bytes
from facelab.files.words import distinct
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.size import check_face_size
from facelab.looks import followed, turn_eyes
from facelab.models.components import principal_components
from facelab.models.evaluation import rms_error
from facelab.motion import MotionSequence
from facelab.posing.clips import check_clip
from facelab.storage import atomic_path, check_writable

_METRES = 1e-3  # for a millimetre
_SKIN = {
    "name": "skin",
    "pbrMetallicRoughness": {
        "baseColorFactor": [0.80, 0.62, 0.53, 1.0],
        "metallicFactor": 0.0,
        "roughnessFactor": 0.6,
    },
}


def write_glb(
    path,
    mesh,
    deltas=None,
    names=None,
    times=None,
    weights=None,
    interpolation="LINEAR",
    props=(),
    gaze=None,
):
    """Write a face, its morph targets and their animation as GLB, whole or not at all.

    Targets that move few vertices are stored sparsely. Names go to `mesh.extras.targetNames`,
    where Blender, three.js and others look for them.

    Parameters
    ----------
    path : str or Path
        Ending in .glb.
    mesh : TriangleMesh
        The face at rest, millimetres; metres in the file.
    deltas : ndarray of shape (n_targets, n_vertices, 3), optional
        Displacement of every vertex at weight 1, millimetres.
    names : sequence of str, optional
        Of the targets, each once.
    times : ndarray of shape (n_keys,), optional
        Seconds, 0 or more, ascending.
    weights : ndarray of shape (n_keys, n_targets), optional
        Of the targets at those times; the face rests at weights of 0 without them.
    interpolation : {"LINEAR", "STEP", "SMOOTH"}
        Between keys. SMOOTH is a cubic spline at rest in every key: 3 s^2 - 2 s^3.
    props : iterable of Prop or (TriangleMesh, colors)
        Eyes and teeth, each a mesh of its own. Those that follow the face have the same targets,
        so that teeth go with the jaw.
    gaze : ndarray of shape (n_targets, 2), optional
        Where the eyes look in each target, see `facelab.looks.turn_eyes`.

    Raises
    ------
    ValueError, TypeError
        For shapes that do not fit, names twice, times that do not ascend, or what is no mesh;
        nothing is written.

    Warns
    -----
    UserWarning
        If the size of the mesh is no face's in millimetres.

    References
    ----------
    Khronos Group, glTF 2.0 specification, sections 3.6, 3.7 and 3.11.
    """
    check_choice(interpolation, "interpolation", ("LINEAR", "STEP", "SMOOTH"))
    if not isinstance(mesh, TriangleMesh):
        raise TypeError(f"mesh is a {type(mesh).__name__}; give a TriangleMesh.")
    check_writable(path)  # before the work
    check_face_size(mesh.vertices, "mesh")
    n, props = mesh.n_vertices, list(props)
    deltas = np.zeros((0, n, 3)) if deltas is None else deltas
    deltas = as_finite(deltas, "deltas", ("n_targets", n, 3))
    names = [f"target {k + 1}" for k in range(len(deltas))] if names is None else list(names)
    if len(names) != len(deltas):
        raise ValueError(f"names has {len(names)} entries, but deltas has {len(deltas)} targets.")
    twice = sorted({m for m in names if names.count(m) > 1})
    if twice:
        raise ValueError(f"names holds {', '.join(twice)} more than once; each needs its own.")
    if (times is None) != (weights is None):
        raise ValueError("times and weights belong together; give both or neither.")
    if times is not None:
        times = as_finite(times, "times", ("n_keys",))
        weights = as_finite(weights, "weights", (len(times), len(deltas)))
        if not len(times) or times[0] < 0 or (np.diff(times.astype(np.float32)) <= 0).any():
            raise ValueError("times must ascend from 0 or more (in float32), each once.")
        if not len(deltas):
            raise ValueError("times are given, but no deltas that could be animated.")
    file = _File()
    names = [str(m) for m in names]
    file.add("face", mesh, deltas, names, _SKIN)
    looks = np.zeros((len(deltas), 2)) if gaze is None else gaze
    looks = as_finite(looks, "gaze", (len(deltas), 2))
    turned = [turn_eyes(props, look) for look in looks]
    for i, prop in enumerate(props):
        file.add_prop(prop, mesh.vertices, deltas, names, [parts[i] for parts in turned])
    if times is not None:
        file.add_animation(times, weights, interpolation)
    data = file.bytes()
    with atomic_path(path) as part:
        part.write_bytes(data)


def write_clip_glb(path, clip, session, props=()):
    """Write a key-framed clip as an animated GLB.

    With a blendshape rig its units are the morph targets, names kept; with another model, or eyes
    that were turned beyond what its units do, each key pose is one, called as in the clip. Between
    keys the file moves as the clip does.

    Parameters
    ----------
    path : str or Path
    clip : Clip
    session : PosingSession
        Whose model made the clip's poses.
    props : iterable of Prop or (TriangleMesh, colors)
        Eyes and teeth, see `write_glb`.

    Raises
    ------
    ValueError, TypeError
        For a clip of another number of coefficients, or what is no clip; nothing is written.
    """
    check_clip(clip, session)
    check_writable(path)  # before the work
    way = {"smooth": "SMOOTH", "linear": "LINEAR"}[clip.easing]
    if session.model.named and not clip.gaze.any():
        rest = session.neutral.vertices
        deltas = session.vertices_of(np.eye(clip.poses.shape[1])) - rest
        model = session.model
        names = [n for r in range(len(model.slices)) for n in model.component_names(r)]
        write_glb(path, session.neutral, deltas, names, clip.times, clip.poses, way, props)
        return
    deltas = session.vertices_of(clip.poses) - session.neutral.vertices
    shares = np.eye(len(clip.times))
    names = distinct(clip.names)
    write_glb(path, session.neutral, deltas, names, clip.times, shares, way, props, gaze=clip.gaze)


def write_motion_glb(path, motion, n_modes=30):
    """Write a mesh in motion as an animated GLB: its mean and its strongest modes as targets.

    A file with a target for each frame would be too large for any viewer. Weights stay within 0
    and 1, where sliders of other programs end. Lost frames have no key: the file moves straight
    across them.

    Parameters
    ----------
    path : str or Path
    motion : MotionSequence
    n_modes : int, default=30
        Principal components to keep; fewer where the motion has no more.

    Returns
    -------
    rms : float
        What is lost by keeping few modes, RMS over valid frames and vertices, millimetres.

    Raises
    ------
    ValueError, TypeError
        For a motion without a valid frame, or what is none; nothing is written.

    Examples
    --------
    >>> import facelab
    >>> motion = facelab.load_registered("M1", size="small", progress=False).motion("train")
    >>> facelab.files.write_motion_glb("take.glb", motion, n_modes=60) < 0.2  # millimetres
    True
    """
    check_type(motion, "motion", MotionSequence, "MotionSequence(positions, fps, mesh)")
    n_modes = check_count(n_modes, "n_modes", 1, None, "modes")
    check_writable(path)  # before the work
    if not motion.valid.any():
        raise ValueError("motion has no valid frame: there is nothing to write.")
    X = motion.displacements()
    mean, modes, _ = principal_components(X, min(n_modes, max(len(X) - 1, 0), X.shape[1]))
    Z = (X - mean) @ modes.T
    left = rms_error(X, mean + Z @ modes)
    low, size = Z.min(axis=0), np.ptp(Z, axis=0)
    moving = size > 0
    low, size, modes, Z = low[moving], size[moving], modes[moving], Z[:, moving]
    deltas = np.vstack([mean + low @ modes, size[:, None] * modes])
    weights = np.column_stack([np.ones(len(Z)), (Z - low) / size])
    names = ["mean", *(f"mode {k + 1}" for k in range(len(modes)))]
    times = np.flatnonzero(motion.valid) / motion.fps
    write_glb(path, motion.mesh, deltas.reshape(len(deltas), -1, 3), names, times, weights)
    return left


class _File(GltfPieces):
    """A GLB in the making: parts of a face, each with a node, a mesh and a material of its own."""

    def __init__(self):
        asset = {"version": "2.0", "generator": "facelab"}
        super().__init__({"asset": asset, "scene": 0, "scenes": [{"nodes": []}]})
        self._moving = []

    def add(self, name, mesh, deltas, names, material, colors=None):
        """Add a part; the face is the first."""
        attributes = {
            "POSITION": self.accessor(_METRES * mesh.vertices, "VEC3", ARRAY, bounds=True),
            "NORMAL": self.accessor(_unit_normals(mesh), "VEC3", ARRAY),
        }
        if colors is not None:  # glTF mixes colours in linear light
            linear = np.asarray(colors).clip(0, 1) ** 2.2
            attributes["COLOR_0"] = self.accessor(linear, "VEC3", ARRAY)
        primitive = {
            "attributes": attributes,
            "indices": self.accessor(mesh.faces.ravel(), "SCALAR", ELEMENTS),
            "material": self.append("materials", {"name": name, "doubleSided": True} | material),
            "mode": 4,
        }
        shape = {"name": name, "primitives": [primitive]}
        node = self.append("nodes", {"name": name, "mesh": self.append("meshes", shape)})
        self.json["scenes"][0]["nodes"].append(node)
        if len(deltas):
            primitive["targets"] = [{"POSITION": self.target(_METRES * d)} for d in deltas]
            shape |= {"weights": [0.0] * len(deltas), "extras": {"targetNames": names}}
            self._moving.append(node)

    def add_prop(self, prop, rest, deltas, names, turned):
        """Add a part beside the face.

        `turned` are the same part as it is with each delta: an eye may look elsewhere.
        """
        part, colors = prop
        part = part.with_vertices(followed(prop, rest))  # the face need not be at rest
        if any(getattr(each, "move", None) is not None for each in turned):
            posed = [followed(t, rest + d) for t, d in zip(turned, deltas, strict=True)]
            deltas = np.stack(posed) - part.vertices
        else:
            deltas = []
        name = getattr(prop, "name", f"part_{len(self.json['meshes'])}")
        rough = 1.0 - 0.8 * getattr(prop, "gloss", 0.0)
        surface = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": rough}}
        self.add(name, part, deltas, names, surface, colors)

    def add_animation(self, times, weights, interpolation):
        if interpolation == "SMOOTH":  # tangent in, value, tangent out of each key
            still = np.zeros_like(weights)
            weights, interpolation = np.stack([still, weights, still], axis=1), "CUBICSPLINE"
        tracks = [(weights, self._moving)]
        self.append("animations", self.animation("clip", times, tracks, interpolation))

    def bytes(self):
        self.json["buffers"] = [{"byteLength": len(self.added)}]
        for view in self.json["bufferViews"]:
            view["buffer"] = 0
        return glb_bytes(self.json, bytes(self.added))


def _unit_normals(mesh):
    """Normals of length one, also where triangles have no area."""
    normals = mesh.normals
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0.5, normals, [0.0, 0, 1])
