"""The four synthetic actors."""

from data_synth import actors
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.keeping import cache_dir

ACTORS = tuple(actors.ACTORS)
"""Their names, in the order in which Fig. 5 of Tena et al. adds them to the training set."""


def load_capture(actor, size="default", random_state=0, root=None, progress=True):
    """The marker capture of one of the four synthetic actors, made on first use and kept.

    Parameters
    ----------
    actor : str
        One of `ACTORS`: M1, F1, M2 or F2.
    size : {"default", "small"}
        All takes at 120 frames a second (the largest, M1: 120 MB, half a minute), or a few at
        60 on a coarse mesh, for tests.
    random_state : int, default=0
        All that happens follows from it; the actors' faces and manners do not change.
    root : str or Path, optional
        Where it is kept; else `cache_dir()`, or a temporary folder, with a warning, where that
        cannot be written. One that is incomplete, damaged or out of date is made again.
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

    return open_capture(
        actor, root or cache_dir(), size, random_state, progress, spare=root is None
    )


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

    Examples
    --------
    >>> import facelab
    >>> facelab.load_template(4375).n_vertices
    4375
    """
    from data_synth.template import build_template

    face = build_template(n_vertices=n_vertices)
    return TriangleMesh(
        face.vertices, face.faces, dict(zip(MULTI_PIE, face.landmarks.tolist(), strict=True))
    )
