"""What passes from one step to the next as npz: a mesh in motion, a face and how it follows."""

import numpy as np
import scipy.sparse as sp

from facelab.checks import as_indices, check_type
from facelab.geometry.binding import LinearBinding
from facelab.geometry.mesh import TriangleMesh
from facelab.motion import MotionSequence
from facelab.storage import StoredArrays, existing_file, open_npz, save_npz

_MOTION = "motion", 1
_FACE = "face", 1


def npz_kind(path):
    """What an npz file of facelab says that it holds ("motion", "rig", ...): str.

    Empty for one that somebody else wrote.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing or damaged file.

    Examples
    --------
    >>> import facelab
    >>> facelab.files.write_rig("face.npz", facelab.load_example().rig)
    >>> facelab.files.npz_kind("face.npz")
    'rig'
    """
    path = existing_file(path, "npz file")
    with open(path, "rb") as file, StoredArrays(path, file) as stored:
        return str(stored.read("facelab_kind", (), "U")) if "facelab_kind" in stored else ""


def write_motion(path, motion):
    """Write a mesh in motion to an .npz file that `read_motion` reads, whole or not at all.

    Parameters
    ----------
    path : str or Path
        Ends in .npz.
    motion : MotionSequence
        Positions keep their type (float32 takes half the room of float64).

    Examples
    --------
    >>> import numpy as np
    >>> import facelab
    >>> face = facelab.load_template(4375)
    >>> still = facelab.MotionSequence(face.vertices + np.zeros((2, 1, 1)), 60.0, face)
    >>> facelab.files.write_motion("still.npz", still)
    >>> facelab.files.read_motion("still.npz")
    MotionSequence(2 frames of 4375 vertices, 60 frames/s, 0 lost)
    """
    check_type(motion, "motion", MotionSequence, "MotionSequence(positions, fps, mesh)")
    own = dict(positions=motion.positions, fps=motion.fps, valid=motion.valid)
    save_npz(path, *_MOTION, **own, **mesh_arrays(motion.mesh))


def read_motion(path):
    """The mesh in motion that `write_motion` wrote: MotionSequence.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is missing, damaged, incomplete, of another kind or of another version.
    """
    with open_npz(path, *_MOTION) as stored:
        mesh = _mesh(stored)
        valid = stored.read("valid", ("n_frames",), "b")
        shape = len(valid), mesh.n_vertices, 3
        fps = float(stored.read("fps", (), "f"))
        return MotionSequence(stored.read("positions", shape, "f"), fps, mesh, valid)


def write_face(path, neutral, binding=None):
    """Write the face that a model poses, and how it follows the model's vertices, as .npz.

    With the file of `RegionModel.save` it is all that a session needs.

    Parameters
    ----------
    path : str or Path
        Ends in .npz.
    neutral : TriangleMesh
        The face at rest, millimetres.
    binding : LinearBinding, optional
        Of that face to the control vertices of the model; none where the model has all vertices.

    Raises
    ------
    ValueError, TypeError
        For a binding of another face, or what is no face; nothing is written.

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_template(4375)
    >>> facelab.files.write_face("face.npz", face)
    >>> neutral, binding = facelab.files.read_face("face.npz")
    >>> neutral.n_vertices, binding is None
    (4375, True)
    """
    check_type(neutral, "neutral", TriangleMesh, "give the face at rest")
    arrays = mesh_arrays(neutral)
    if binding is not None:
        check_type(binding, "binding", LinearBinding, "give that of `bind_to_samples`")
        if not np.array_equal(binding.mesh.vertices, neutral.vertices):
            raise ValueError("binding is of another face than neutral; bind the neutral itself.")
        W = sp.csr_array(binding.weights)
        arrays |= dict(samples=binding.samples, weights=W.data, columns=W.indices, rows=W.indptr)
    save_npz(path, *_FACE, **arrays)


def read_face(path):
    """The face that `write_face` wrote, and how it follows: TriangleMesh, LinearBinding or None.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is missing, damaged, incomplete, of another kind or of another version.
    """
    with open_npz(path, *_FACE) as stored:
        mesh = _mesh(stored)
        if "samples" not in stored:
            return mesh, None
        n = mesh.n_vertices
        samples = stored.read("samples", ("n_control",), "iu")
        samples = as_indices(samples, "samples", n, "vertices of the mesh")
        weights = stored.read("weights", ("n_weights",), "f")
        columns = stored.read("columns", weights.shape, "iu")
        rows = stored.read("rows", (n + 1,), "iu")
        return mesh, LinearBinding(mesh, samples, _weights(weights, columns, rows, len(samples)))


def _weights(weights, columns, rows, n_control):
    """The sparse matrix of a binding, refused unless each of its rows sums to one."""
    ends = rows[0] == 0 and rows[-1] == len(weights) and (np.diff(rows.astype(int)) >= 0).all()
    if not ends or (columns >= n_control).any() or (columns < 0).any():
        raise ValueError("its weights name control vertices that are not there")
    W = sp.csr_array((weights, columns, rows), shape=(len(rows) - 1, n_control))
    if not np.allclose(W.sum(axis=1), 1, atol=1e-6):  # NaN too
        raise ValueError("its weights do not sum to one for each vertex")
    return W


def stored_rate(stored, what):
    """Frames a second of an npz file as float, None where it has none; refused if not above 0."""
    if "fps" not in stored:
        return None
    rate = stored.read("fps", kinds="iuf")
    if rate.size != 1 or not 0 < rate.ravel()[0] < np.inf:
        raise ValueError(
            f"{stored.path}: fps is {rate.tolist()!s:.60}, but must be one {what} above 0."
        )
    return float(rate.ravel()[0])


def mesh_arrays(mesh):
    """The arrays of a mesh with its landmarks, as npz files of facelab hold them: dict."""
    names, places = list(mesh.landmarks), list(mesh.landmarks.values())
    return dict(
        vertices=mesh.vertices,
        faces=mesh.faces,
        landmark_names=np.array(names, dtype=str),
        landmarks=np.array(places, dtype=np.int64),
    )


def _mesh(stored):
    vertices = stored.read("vertices", ("n_vertices", 3), "f")
    faces = stored.read("faces", ("n_faces", 3), "iu")
    names = stored.read("landmark_names", ("n_landmarks",), "U").tolist()
    places = stored.read("landmarks", (len(names),), "iu").tolist()
    if len(set(names)) < len(names):
        raise ValueError("landmark_names holds a name twice")
    return TriangleMesh(vertices, faces, dict(zip(names, places, strict=True)))
