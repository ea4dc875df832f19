"""Yu and Liu's Algorithm 1 as it is printed: every alpha, the mesh deformed, the error measured.

On a simplified mesh the error of Eq. 10 is measured after step 3, the Laplacian deformation of the
full mesh (Eq. 12), so it is no longer what Eq. 9 makes small: the proof that alpha adds nothing
(see `ExpressionFit.choose`) does not reach it. How much alpha then gains is measured here.
"""

from dataclasses import dataclass

import numpy as np

from facelab.expression.regression import regress_expression
from facelab.expression.transfer import SimplifiedRig
from facelab.expression.units import prepare_units
from facelab.numeric.threads import single_threaded

EPSILON = 0.01
"""Step 1 sets it and no step uses it; Eq. 2 bounds the residual by a letter of that name."""


@dataclass(frozen=True, eq=False)
class Algorithm1:
    """What Algorithm 1 finds.

    Attributes
    ----------
    alphas : ndarray of shape (A,)
    rms : ndarray of shape (A,)
        Of the full mesh against the sketch, over its vertices, millimetres.
    e_rms : ndarray of shape (A,)
        Eq. 10 as printed, n outside the root: rms / sqrt(n_vertices).
    faces : ndarray of shape (A, n_vertices, 3)
        The full mesh for every alpha, millimetres.
    plain : float
        The rms that alpha has to beat: of the plain bounded fit, lam = 0, deformed alike.
    """

    alphas: np.ndarray
    rms: np.ndarray
    e_rms: np.ndarray
    faces: np.ndarray
    plain: float

    @property
    def best(self):
        """Index of the alpha with the smallest error, step 5."""
        return int(self.rms.argmin())

    @property
    def gain(self):
        """What the best alpha wins over the plain bounded fit, millimetres; below 0 if it loses."""
        return self.plain - float(self.rms.min())

    @property
    def within(self):
        """Alphas whose e_rms, as printed, is at most epsilon: ndarray of bool, shape (A,)."""
        return self.e_rms <= EPSILON


@single_threaded
def algorithm_1(rig, sketch, lam=0.015, alphas=range(101), n_vertices=None, align="check"):
    """Algorithm 1 on the full mesh, or on a simplified one that leads it.

    Parameters
    ----------
    rig : BlendshapeRig
        On the full mesh.
    sketch : ndarray of shape (n_full, 3)
        On the full mesh, millimetres.
    lam : float, default=0.015
        Millimetres; the paper's 1 at 4,375 vertices.
    alphas : iterable of float
    n_vertices : int, optional
        Of the simplified mesh; the full one if left out.
    align
        As for `regress_expression`.

    Returns
    -------
    Algorithm1

    References
    ----------
    Yu and Liu 2014, Algorithm 1, Eq. 9, 10 and 12.
    """
    sketch = np.asarray(sketch, dtype=float)
    if n_vertices is None:
        basis, seen, drive = prepare_units(rig), sketch, lambda V: V
    else:
        simple = SimplifiedRig(rig, n_vertices)
        basis, seen, drive = prepare_units(simple.rig), sketch[simple.samples], simple.drive
    fit = regress_expression(basis, seen, lam, alphas, align=align)
    bare = regress_expression(basis, seen, 0, [0], align=align)
    wanted = sketch if fit.alignment is None else fit.alignment.apply(sketch)
    faces = np.array([drive(fit.vertices(i)) for i in range(len(fit.alphas))])
    rms = _rms(faces - wanted)
    return Algorithm1(
        alphas=fit.alphas,
        rms=rms,
        e_rms=rms / np.sqrt(len(sketch)),
        faces=faces,
        plain=float(_rms(drive(bare.vertices(0)) - wanted)),
    )


def _rms(off):
    return np.sqrt((off**2).sum(axis=-1).mean(axis=-1))
