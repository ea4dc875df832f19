"""What the four actors do: sentences with an emotion, a range of motion, FACS combinations.

A performance is a weight for each action unit and a pose of the head in each frame. Speech,
emotion, stress and blinks are made apart and joined so that a weight never leaves [0, 1]; then
the actor's own manner is laid over them.

```
script.py        the sentences, and how they sound
tracks.py        building blocks: noise, bumps, envelopes, blinks, and how weights join
speech.py        what the mouth aims at, and how sounds colour each other
emotion.py       the colour of a sentence, stress, the head
combinations.py  which units go together; the FACS combinations
manner.py        strength, asymmetry and coupling of an actor's units
takes.py         `perform_sentence`, `perform_rom`, `perform_facs`
```
"""

from data_synth.performance.combinations import N_FACS
from data_synth.performance.script import SENTENCES
from data_synth.performance.takes import NECK, perform_facs, perform_rom, perform_sentence

__all__ = ["NECK", "N_FACS", "SENTENCES", "perform_facs", "perform_rom", "perform_sentence"]
