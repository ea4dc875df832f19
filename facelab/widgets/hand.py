"""What a mouse does on a face, done in the page: the kernel only hears of it.

From a press on the page itself finds what was taken hold of, moves the face and draws the pins; the
answer to the press says how the face follows. So a drag feels and ends the same on any wire.
"""

import numpy as np
import traitlets

from facelab.posing.bounded import BoundedPull
from facelab.widgets.in_touch import InTouch, script, style


class Hand(InTouch):
    """Sits on the canvas of a face, see `FaceView`.

    Attributes
    ----------
    pins : list of [vertex, target, color, name]
    names : list of str
        Of vertices; `name_of` (uint32) says which is whose. Empty for numbers.
    away : float
        From where the whole face is seen, millimetres.
    settled : str
        The last press that the kernel has dealt with: what it sent is then what is shown.
    basis : dict
        Of the last `BoundedPull`, sent once.
    """

    _esm, _css = script("hand_math", "hand"), style("hand")
    ids = traitlets.Dict().tag(sync=True)
    middle = traitlets.List().tag(sync=True)
    n_vertices = traitlets.Int().tag(sync=True)
    n_faces = traitlets.Int().tag(sync=True)
    rim = traitlets.List().tag(sync=True)
    riders = traitlets.Dict().tag(sync=True)
    size = traitlets.List().tag(sync=True)
    grabs = traitlets.Bool(False).tag(sync=True)
    hovers = traitlets.Bool(False).tag(sync=True)
    along_normal = traitlets.Bool(False).tag(sync=True)
    pins = traitlets.List().tag(sync=True)
    takes_pins = traitlets.Bool(True).tag(sync=True)
    names = traitlets.List().tag(sync=True)
    name_of = traitlets.Bytes().tag(sync=True)
    settled = traitlets.Unicode().tag(sync=True)
    away = traitlets.Float().tag(sync=True)
    basis = traitlets.Dict().tag(sync=True)

    def __init__(self, react, **kwargs):
        super().__init__(**kwargs)
        self._basis = None
        self.on_msg(lambda _, message, __: react(message))

    def answer(self, press, pull, vertex, target, ahead):
        """Tell the page how the face on screen follows a pull.

        Parameters
        ----------
        press : str
        pull : ndarray of shape (n_vertices, 3, 3) or BoundedPull
        vertex : int or None
        target : ndarray of shape (3,)
            Where its target is before the pull, millimetres.
        ahead : ndarray of shape (3,)
            How far this face is pulled more than the mouse moves.
        """
        told = {
            "do": "answer",
            "press": press,
            "vertex": vertex if vertex is None else int(vertex),
            "target": np.asarray(target).tolist(),
            "ahead": np.asarray(ahead).tolist(),
        }
        if not isinstance(pull, BoundedPull):
            self._tell(told, "affine", {"D": pull.astype(np.float32)})
            return
        if pull.basis is not self._basis:
            self._basis = pull.basis
            weights = pull.basis.weights
            self.basis = {
                "rows": _packed(pull.basis.rows),
                "weights": None if weights is None else packed_sparse(weights),
            }
        if pull.centre is not None:
            told["ball"] = {"centre": pull.centre.tolist(), "radius": float(pull.radius)}
        names = {"start": "start", "free": "free", "slope": "slope", "M": "inverse"}
        arrays = {k: getattr(pull, v) for k, v in (names | {n: n for n in _ENDS}).items()}
        self._tell(told, "bounded", arrays)

    def slide(self, hold, slider, shares, changes):
        """Tell the page the faces of a slider, as `FaceView.begin_slide`."""
        told = {"do": "slide", "press": hold, "slider": slider.model_id}
        told["n_changes"] = len(changes)
        self._tell(told, "course", {"shares": shares, "D": changes.astype(np.float32)})

    def _tell(self, told, kind, arrays):
        told |= {"kind": kind, "buffers": list(arrays)}
        self.send(told, buffers=[_packed(a) for a in arrays.values()])


_ENDS = ("lo", "hi", "give")


def _packed(array):
    return np.ascontiguousarray(array).tobytes()


def packed_sparse(matrix):
    """A sparse array as the page reads it: dict of buffers."""
    matrix = matrix.tocsr()
    return {
        "starts": _packed(matrix.indptr.astype(np.int32)),
        "columns": _packed(matrix.indices.astype(np.int32)),
        "values": _packed(matrix.data.astype(float)),
    }


def packed_riders(matrix, offsets):
    """Vertices that ride on others, matrix @ V + offsets, as the page reads them."""
    return {**packed_sparse(matrix), "offsets": _packed(offsets.astype(float))}
