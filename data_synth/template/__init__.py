"""A procedural human face: anatomical curves, a fair surface through them, an even mesh.

```
skin.py      forehead, cheeks, jaw, midline profile, folds     an Anatomy's measurements as named
features.py  nose, mouth, eyes                                 points in space
surface.py   the smoothest map from the layout to space that passes through them
plane.py     lines, polygons, triangles in the plane: nothing of faces in it
lines.py     loops round the openings, midline, border: where every mesh has edges
layout.py    the even mesh of a density, made once, on the average face
parts.py     landmarks, regions and curves on it
face.py      `build_template`: the mesh laid over the surface of one anatomy
```

The *layout* is the left half of the face unrolled like a map, with openings for eye and mouth:
every named point has a fixed place in it. The mesh is made there and never sees another anatomy
than the average one, so all faces of one density correspond vertex by vertex.
"""

from data_synth.template.face import Template, build_template

__all__ = ["Template", "build_template"]
