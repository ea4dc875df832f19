"""The example that every lab starts with."""

from dataclasses import dataclass, field

import numpy as np

from facelab.data.cache import DataUnavailable
from facelab.data.ict import load_ict_facekit, load_ict_props
from facelab.data.takes import TAKES, load_take
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.looks import face_props
from facelab.motion import WeightSequence
from facelab.rig import BlendshapeRig


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
    props : list of facelab.looks.Prop
        To show with the face: eyes, teeth, a tongue.
    """

    about: str
    rig: BlendshapeRig
    train: WeightSequence
    test: WeightSequence
    props: list = field(repr=False)


def load_example():
    """The generic face and two recorded takes, or a synthetic actor where they are not at hand.

    Returns
    -------
    Example

    Examples
    --------
    >>> import facelab
    >>> example = facelab.load_example()
    >>> example.train.n_frames > 100
    True
    """
    try:
        rig, props = load_ict_facekit(), load_ict_props()
        train, test = (load_take(name) for name in TAKES)
    except DataUnavailable as missing:
        return _synthetic_example(str(missing))
    about = (
        "RECORDED motion: the generic face of ICT-FaceKit, moved by two takes of one performer "
        "(alex_rom_3 to learn from, alex_rom_4 to test)."
    )
    return Example(about, rig, train, test, props)


def synthetic_props(face):
    """Eyes, teeth and a tongue of a synthetic face, to be shown with it.

    Parameters
    ----------
    face : data_synth.template.Template

    Returns
    -------
    list of facelab.looks.Prop
        Teeth and tongue go with the jaw.
    """
    marks = dict(zip(MULTI_PIE, face.landmarks.tolist(), strict=True))
    return face_props(TriangleMesh(face.vertices, face.faces, marks))


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
