"""The four synthetic actors: faces, action units, performances, captures, all from code.

```
actors.py        the actors themselves: all numbers that make one
anatomy.py       what is measured on a face; identity.py draws other people
template/        a face from an anatomy: the same mesh on every face
units.py         the forty action units by name
muscles.py       what pulls the skin; articulation.py: jaw, lids, lips that meet
action_units.py  the units of one face, as a rig
performance/     what an actor does: weights and head pose in time
capture/         what a capture system sees of it, in files
compare_scan.py  units and faces beside those of ICT-FaceKit
```

Everything follows from an actor and a seed. `python -m data_synth` makes all captures.
"""
