"""What a face shows beside its skin: eyes, teeth, light. Nothing of it enters the mathematics."""

from facelab.looks.lining import Lining
from facelab.looks.props import Prop, face_props, followed, lids_off, shown, turn_eyes

__all__ = ["Lining", "Prop", "face_props", "followed", "lids_off", "shown", "turn_eyes"]
