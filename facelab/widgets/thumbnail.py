"""Small pictures of a face, drawn without a browser in about a tenth of a second."""

import base64
import io
from pathlib import Path

import matplotlib
import matplotlib.image
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from facelab.geometry.mesh import vertex_normals
from facelab.looks import Lining, lids_off, shown, turn_eyes
from facelab.looks.occlusion import skin_colors
from facelab.looks.raster import rasterise
from facelab.plotting import SKIN

_LIGHT = np.array([-0.28, 0.42, 0.86])
_FONT = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"  # has Greek letters
_BACKGROUND = (0.957, 0.957, 0.949)
_FINER = 2  # samples along a pixel


def captioned(png, *lines):
    """The picture with lines of text below it: base64 of a PNG, as a notebook keeps it."""
    drawn = Image.open(io.BytesIO(png)).convert("RGB")
    font = ImageFont.truetype(_FONT, 12)
    width = max(drawn.width, *(16 + round(font.getlength(text)) for text in lines))
    paper = Image.new("RGB", (width, drawn.height + 6 + 18 * len(lines)), "white")
    paper.paste(drawn)
    for row, text in enumerate(lines):
        at = (8, drawn.height + 5 + 18 * row)
        ImageDraw.Draw(paper).text(at, text, fill="#444", font=font)
    file = io.BytesIO()
    paper.save(file, "PNG")
    return base64.b64encode(file.getvalue()).decode()


class Thumbnails:
    """Pictures of one face in many poses, from the front.

    Parameters
    ----------
    mesh : TriangleMesh
        The face at rest; it fills the picture.
    props : iterable of Prop or (TriangleMesh, colors)
        Eyes and teeth.
    width, height : int
        Pixels.
    """

    def __init__(self, mesh, props=(), width=136, height=152):
        self.width, self.height = width, height
        self._mesh, self._lining, self._props = mesh, Lining(mesh), list(props)
        low, high = mesh.vertices[:, :2].min(axis=0), mesh.vertices[:, :2].max(axis=0)
        self._middle = (low + high) / 2
        self._scale = min(np.array([width, height]) / (high - low)) / 1.12  # pixels per mm

    def png(self, vertices, gaze=(0.0, 0.0), colors=None):
        """The face at these positions, shape (n_vertices, 3), millimetres, as bytes of a PNG.

        `gaze` is where its eyes look, see `facelab.looks.turn_eyes`; `colors`, shape
        (n_vertices, 3), 0 to 1, are those of its skin.
        """
        lining, vertices = self._lining, lids_off(self._props, vertices)
        if colors is None:
            colors = skin_colors(self._mesh, SKIN, self._props)
        parts = [(vertices, self._mesh.faces, colors, 1.0)]
        parts.append((lining.vertices(vertices), lining.faces, lining.colors, 0.0))
        for prop in turn_eyes(self._props, gaze):
            mesh, _ = prop
            at, colors = shown(prop, vertices)
            parts.append((at, mesh.faces, colors, 1.0))
        file = io.BytesIO()
        matplotlib.image.imsave(file, self._drawn(parts), format="png")
        return file.getvalue()

    def _drawn(self, parts):
        """Parts (vertices, faces, colours, shading) from the front: (height, width, 3)."""
        V = np.concatenate([part[0] for part in parts])
        start = np.cumsum([0] + [len(part[0]) for part in parts])
        F = np.concatenate([part[1] + s for part, s in zip(parts, start, strict=False)])
        paint = np.concatenate([_lit(*part) for part in parts]).clip(0, 1)
        size = _FINER * np.array([self.width, self.height])
        at = (V[:, :2] - self._middle) * _FINER * self._scale * [1, -1] + size / 2
        face, weights = rasterise(at[F], V[F, 2], *size)
        image = np.tile(np.float64(_BACKGROUND), (*face.shape, 1))
        seen = face >= 0
        image[seen] = np.einsum("nc,ncx->nx", weights[seen], paint[F[face[seen]]])
        means = image.reshape(self.height, _FINER, self.width, _FINER, 3).mean(axis=(1, 3))
        return means.clip(0, 1)  # weights may add up to a hair more


def _lit(V, F, colors, shading):
    light = 0.5 + 0.55 * (vertex_normals(V, F) @ _LIGHT).clip(0)
    return np.asarray(colors) * (1 + shading * (light[:, None] - 1))
