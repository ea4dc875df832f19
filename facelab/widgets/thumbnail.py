"""Small pictures of a face, drawn without a browser in about a tenth of a second."""

import base64
import io
from pathlib import Path

import matplotlib
import matplotlib.image
import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image, ImageDraw, ImageFont

from facelab.geometry.mesh import vertex_normals
from facelab.looks import Lining, followed, turn_eyes
from facelab.plotting import SKIN

_LIGHT = np.array([-0.28, 0.42, 0.86])
_FONT = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"  # has Greek letters
_BACKGROUND = (0.957, 0.957, 0.949)


def captioned(png, *lines):
    """The picture with lines of text below it: base64 of a PNG, as a notebook keeps it."""
    drawn = Image.open(io.BytesIO(png)).convert("RGB")
    paper = Image.new("RGB", (drawn.width, drawn.height + 6 + 18 * len(lines)), "white")
    paper.paste(drawn)
    font = ImageFont.truetype(_FONT, 12)
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
        lining = self._lining
        if colors is None:
            colors = np.tile(to_rgb(SKIN), (len(vertices), 1))
        parts = [(vertices, self._mesh.faces, colors, 1.0)]
        parts.append((lining.vertices(vertices), lining.faces, lining.colors, 0.0))
        for prop in turn_eyes(self._props, gaze):
            mesh, colors = prop
            parts.append((followed(prop, vertices), mesh.faces, colors, 1.0))
        drawn = [self._fragments(*part) for part in parts]
        pixel, depth, color = (np.concatenate(a) for a in zip(*drawn, strict=True))
        order = np.argsort(depth)  # what is written last stands in front
        image = np.tile(np.float64(_BACKGROUND), (self.width * self.height, 1))
        image[pixel[order]] = color[order]
        file = io.BytesIO()
        matplotlib.image.imsave(file, image.reshape(self.height, self.width, 3), format="png")
        return file.getvalue()

    def _fragments(self, V, F, colors, shading):
        """Points on the triangles, as close as pixels: pixel, depth and colour of each."""
        V = np.asarray(V, dtype=float)
        at = (V[:, :2] - self._middle) * self._scale * [1, -1] + [self.width / 2, self.height / 2]
        light = 0.5 + 0.55 * (vertex_normals(V, F) @ _LIGHT).clip(0)
        shaded = np.asarray(colors) * (1 + shading * (light[:, None] - 1))
        longest = np.linalg.norm(at[F] - at[np.roll(F, 1, axis=1)], axis=2).max(axis=1, initial=0)
        found = []
        for steps in 2 ** np.arange(10):  # longer ones, of a vertex gone astray, are not drawn
            these = F[(longest <= steps) & (longest > (steps / 2 if steps > 1 else -1))]
            a, b = np.mgrid[: steps + 1, : steps + 1].reshape(2, -1)
            inside = a + b <= steps
            weights = np.stack([a, b, steps - a - b], axis=1)[inside] / steps
            found.append(
                [
                    np.einsum("sc,fcx->fsx", weights, X[these]).reshape(-1, X.shape[1])
                    for X in (at, V[:, 2:], shaded.clip(0, 1))
                ]
            )
        spot, depth, color = (np.concatenate(x) for x in zip(*found, strict=True))
        x, y = np.floor(spot).astype(int).T
        seen = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        return (y * self.width + x)[seen], depth[seen, 0], color[seen]
