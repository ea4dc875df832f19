"""Figures with matplotlib: faces, regions, curves. Readable in print and by the colour-blind."""

from itertools import cycle

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
from matplotlib.colors import to_rgb
from matplotlib.ticker import NullLocator

from facelab.checks import as_finite
from facelab.geometry.mesh import vertex_normals
from facelab.looks.light import shaded
from facelab.looks.lining import Lining
from facelab.looks.occlusion import skin_colors
from facelab.looks.palette import PALETTE, map_colors
from facelab.looks.props import face_props, lids_off, shown
from facelab.looks.raster import rasterise
from facelab.segmentation.clusters import renumbered

SKIN = "#e0b49a"
CURVES = (  # colour and dash; colours after Okabe and Ito, apart for colour-blind readers
    *(("#0072b2", "-"), ("#d55e00", "--"), ("#009e73", ":")),
    *(("#cc79a7", "-."), ("#1a1a1a", "-"), ("#777777", "--")),
)
_FINER = 2  # samples along a pixel
_MOST_PIXELS = 2400
_VIEWS = {"front": (0.0, 0.0), "left": (40.0, 0.0), "right": (-40.0, 0.0), "profile": (88.0, 0.0)}


def region_colors(regions, like=None):
    """A colour for each region, told apart also by the colour-blind: shape (n_regions, 3), 0 to 1.

    In CIEDE2000 regions that touch differ by 15 or more where that can be had, any two by 10 or
    more, for normal vision and the three dichromacies; for up to 20 regions.

    Parameters
    ----------
    regions : Regions
    like : (Regions, ndarray of shape (n_regions, 3)), optional
        Another cut of the same mesh and its colours: what overlaps most looks the same.
    """
    palette = np.array([to_rgb(c) for c in PALETTE])
    a, b = regions.labels[regions.mesh.edges].T
    touch = np.zeros((regions.n_regions,) * 2, dtype=bool)
    touch[a, b] = touch[b, a] = True
    np.fill_diagonal(touch, False)
    kept = np.full(regions.n_regions, -1)
    if like is not None:
        before, colors = like
        same = renumbered(regions.labels, before.labels)
        known = same < before.n_regions
        gap = np.linalg.norm(np.asarray(colors)[:, None] - palette, axis=2)
        kept[regions.labels[known]] = gap.argmin(axis=1)[same[known]]
    return palette[map_colors(touch, kept)]


def draw_face(ax, mesh, vertices=None, colors=None, view="front", props=None, shade=True):
    """Draw a shaded face.

    Parameters
    ----------
    ax : matplotlib Axes
    mesh : TriangleMesh
    vertices : ndarray of shape (n_vertices, 3), optional
        Positions to draw instead of the mesh's own, millimetres.
    colors : ndarray of shape (n_vertices, 3) or str, optional
        Colour of each vertex, 0 to 1, or one for all; if left out the mesh's texture, sampled at
        its vertices, or skin.
    view : {"front", "left", "right", "profile"} or (float, float)
        Or azimuth towards the person's left and elevation, degrees.
    props : iterable of `Prop` or (TriangleMesh, colors), optional
        Eyes and teeth, which follow the face; or still parts. If left out, those that
        `facelab.looks.face_props` makes for it; () for none. Lids are held off such eyes.
    shade : bool, default=True

    Returns
    -------
    callable
        Takes points of shape (n, 3) to the plane of the drawing, shape (n, 2).
    """
    V = mesh.vertices if vertices is None else as_finite(vertices, "vertices", mesh.vertices.shape)
    azimuth, elevation = np.radians(_VIEWS[view] if isinstance(view, str) else view)
    ahead = np.array(
        [
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ]
    )
    right = np.array([np.cos(azimuth), 0, -np.sin(azimuth)])
    axes = np.stack([right, np.cross(ahead, right), ahead])
    props = face_props(mesh) if props is None else list(props)
    V = lids_off(props, V)
    colors = _own_colors(mesh, props) if colors is None else colors
    parts = [(V, mesh.faces, colors, 0.0)]
    lining = Lining(mesh)
    if len(lining.faces):
        parts.append((lining.vertices(V), lining.faces, lining.colors, 0.0))
    parts += [_drawn(prop, V) for prop in props]
    _show(ax, parts, axes, shade)
    return lambda points: np.atleast_2d(points) @ axes[:2].T


def _own_colors(mesh, props):
    if mesh.texture is None:
        return skin_colors(mesh, SKIN, props)
    return mesh.texture.at_vertices(mesh.faces, mesh.n_vertices, to_rgb(SKIN))


def _drawn(prop, V):
    """Vertices, triangles, colours and gloss of a part of a face at V."""
    mesh, _ = prop
    at, colors = shown(prop, V)
    return at, mesh.faces, colors, getattr(prop, "gloss", 0.0)


def _show(ax, parts, axes, shade):
    """Draw parts (vertices, faces, colours, gloss) as one picture, in millimetres."""
    at = np.concatenate([part[0] for part in parts]) @ axes.T
    start = np.cumsum([0] + [len(part[0]) for part in parts])
    faces = np.concatenate([part[1] + s for part, s in zip(parts, start, strict=False)])
    paint = np.concatenate([_paint(part[2], len(part[0])) for part in parts])
    gloss = np.repeat([part[3] for part in parts], [len(part[0]) for part in parts])
    normals = np.concatenate([vertex_normals(part[0], part[1]) for part in parts]) @ axes.T
    low, high = at[faces.ravel(), :2].min(axis=0), at[faces.ravel(), :2].max(axis=0)
    box = ax.get_window_extent()
    scale = _FINER * min(np.array([box.width, box.height]) / (high - low))
    width, height = np.clip(np.ceil(scale * (high - low)).astype(int), 16, _MOST_PIXELS)
    size = np.array([width, height]) / (high - low)
    corners = (at[faces, :2] - [low[0], high[1]]) * size * [1, -1]
    face, weights = rasterise(corners, at[faces, 2], width, height)
    seen, weights = face >= 0, weights[face >= 0]
    ends = np.arange(0, weights.size + 1, 3)
    own = sp.csr_array((weights.ravel(), faces[face[seen]].ravel(), ends), (len(weights), len(at)))
    color, N, gloss = own @ paint, own @ normals, own @ gloss
    N /= np.maximum(np.sqrt(np.einsum("nk,nk->n", N, N)), 1e-9)[:, None]
    behind = N[:, 2] < 0  # the inside, seen through an opening
    if shade:
        color = shaded(color, np.where(behind[:, None], -N, N), gloss)
    color[behind] *= 0.35
    image = np.zeros((height, width, 4))
    image[seen] = np.c_[color, np.ones(len(color))]
    # few colours make small picture files
    image = np.round(_halved(image) * 96) / 96
    ax.imshow(image, extent=(low[0], high[0], low[1], high[1]), interpolation="antialiased")
    ax.set_aspect("equal")
    ax.set_axis_off()
    ax.autoscale_view()


def _paint(colors, n):
    return np.tile(to_rgb(colors), (n, 1)) if isinstance(colors, str) else np.asarray(colors)


def _halved(image):
    """An image of half the size, colours weighted by how opaque they are."""
    image = np.pad(image, [(0, image.shape[0] % 2), (0, image.shape[1] % 2), (0, 0)])
    image[..., :3] *= image[..., 3:]
    rows = image[::2] + image[1::2]
    sums = rows[:, ::2] + rows[:, 1::2]
    return np.concatenate([sums[..., :3] / np.maximum(sums[..., 3:], 1e-9), sums[..., 3:] / 4], 2)


def heat_colors(values, limit, cmap="YlGnBu"):
    """Colours of values from 0 (pale) to `limit` (dark), ten steps: shape (n, 3), 0 to 1."""
    return plt.get_cmap(cmap, 10)(np.clip(np.asarray(values) / limit, 0, 1))[:, :3]


def heat_bar(figure, axes, limit, label, cmap="YlGnBu", **options):
    """The key to `heat_colors`, beside some axes."""
    scale = plt.cm.ScalarMappable(plt.Normalize(0, limit), plt.get_cmap(cmap, 10))
    return figure.colorbar(scale, ax=axes, label=label, extend="max", **options)


def draw_pins(ax, project, vertices, targets):
    """Draw pins as in the viewer: dark on the vertex, yellow on the target, a line between."""
    a, b = project(vertices), project(targets)
    ax.plot(*np.stack([a, b]).transpose(2, 0, 1), color="#1a1a1a", lw=1.2, zorder=5)
    ax.plot(*a.T, "o", color="#0d0d0d", ms=4, zorder=6)
    ax.plot(*b.T, "o", color="#ffd900", mec="#1a1a1a", ms=5, zorder=6)


def new_row(n_faces, size=3.0, titles=()):
    """A row of empty axes for faces: figure, axes."""
    figure, axes = new_grid(1, n_faces, size, titles)
    return figure, axes[0]


def new_grid(n_rows, n_columns, size=3.0, titles=(), fontsize=10):
    """Rows of empty axes for faces: figure, axes of shape (n_rows, n_columns)."""
    figure, axes = plt.subplots(
        n_rows, n_columns, figsize=(size * n_columns, size * 1.2 * n_rows), squeeze=False
    )
    for ax in axes.flat:
        ax.set_axis_off()
    for ax, title in zip(axes.flat, titles, strict=False):
        ax.set_title(title, fontsize=fontsize)
    figure.set_layout_engine("constrained")
    return figure, axes


def plain_log_ticks(ax, x=(), y=()):
    """Logarithmic axes with these ticks, written as plain numbers."""
    for axis, ticks in ((ax.xaxis, x), (ax.yaxis, y)):
        if len(ticks):
            axis.set_ticks(ticks, [f"{t:g}" for t in ticks])
            axis.set_minor_locator(NullLocator())


def draw_curves(ax, x, curves, xlabel, ylabel, **options):
    """Curves by name, each of a colour and dash of its own, with a legend.

    Parameters
    ----------
    ax : matplotlib Axes
    x : array_like of shape (n,)
    curves : dict of str to array_like of shape (n,)
        The first six look different in any print.
    xlabel, ylabel : str
    **options
        For `Axes.plot`, such as lw or marker.
    """
    for (name, y), (color, dash) in zip(curves.items(), cycle(CURVES), strict=False):
        ax.plot(x, y, **{"color": color, "linestyle": dash, "label": name} | options)
    ax.set(xlabel=xlabel, ylabel=ylabel)
    ax.legend(frameon=False, fontsize=8)


def draw_faces(mesh, faces, size=2.0, props=None):
    """A row of faces under their names: figure, axes.

    Parameters
    ----------
    mesh : TriangleMesh
    faces : dict of str to ndarray of shape (n_vertices, 3)
        Millimetres.
    size : float
        Of a face, inches.
    props : iterable of (TriangleMesh, colors)
    """
    figure, axes = new_row(len(faces), size, list(faces))
    for ax, vertices in zip(axes, faces.values(), strict=True):
        draw_face(ax, mesh, vertices, props=props)
    return figure, axes


def label_rows(axes, labels, fontsize=8):
    """Words on the left of each row of faces; axes as from `new_grid`."""
    for ax, label in zip(axes[:, 0], labels, strict=True):
        place = dict(transform=ax.transAxes, rotation=90, va="center", ha="center")
        ax.text(-0.12, 0.5, label, fontsize=fontsize, **place)


def draw_weights(ax, weights, main, named):
    """Weights of action units in [0, 1] as bars.

    Parameters
    ----------
    ax : matplotlib Axes
    weights : dict of str to float
        By unit.
    main : iterable of str
        Units whose bars are orange; the others are blue.
    named : iterable of str
        Units whose names stand over their bars.
    """
    units = list(weights)
    colors = [CURVES[1][0] if name in main else CURVES[0][0] for name in units]
    ax.vlines(range(len(units)), 0, list(weights.values()), colors, lw=2)  # one artist, so fast
    named = sorted(named, key=units.index)
    bars = np.array([units.index(name) for name in named], dtype=float)
    gap = len(units) / 7  # names are wider than bars
    places = np.maximum.accumulate(bars - gap * np.arange(len(bars))) + gap * np.arange(len(bars))
    places += np.mean(bars - places) if len(bars) else 0
    places += max(2 - places.min(initial=2), 0)
    for name, bar, place in zip(named, bars, places, strict=True):
        look = dict(rotation=90, ha="center", va="bottom", fontsize=7, parse_math=False)
        line = dict(arrowstyle="-", lw=0.5, color="#777777", shrinkA=0, shrinkB=1)
        ax.annotate(name, (bar, weights[name]), (place, 1.12), arrowprops=line, **look)
    ax.set_axis_on()
    ax.set(xlim=(-1, len(units)), ylim=(0, 1.8), xticks=[], yticks=[0, 0.5, 1], xlabel="units")
    ax.tick_params(labelsize=7)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines["left"].set_bounds(0, 1)


def draw_sweep(fit, picks, mesh, sketch, faces, props=None, size=1.5, n_named=3):
    """A sketch, and what was found for some alphas: faces over their weights: figure, axes.

    Parameters
    ----------
    fit : ExpressionFit
        Its dominant units have orange bars; between face and bars stands the error.
    picks : sequence of int
        Which alphas, as indices into `fit.alphas`.
    mesh : TriangleMesh
        Of the sketch and the faces.
    sketch : ndarray of shape (n_vertices, 3)
        Millimetres.
    faces : sequence of ndarray of shape (n_vertices, 3)
        One for each of `picks`.
    props : iterable of (TriangleMesh, colors)
    size : float
        Of a face, inches.
    n_named : int
        How many dominant units are named, those that move the face most.
    """
    titles = ["sketch", *(rf"$\alpha$ = {fit.alphas[i]:g}" for i in picks)]
    figure, axes = new_grid(2, len(titles), size, titles)
    draw_face(axes[0, 0], mesh, sketch, props=props)
    main = fit.roles()[0]
    reach = np.linalg.norm(fit.basis.rig.deltas, axis=(1, 2)) * fit.weights[picks[0]]
    named = sorted(main, key=lambda name: -reach[fit.names.index(name)])[:n_named]
    for (above, below), i, vertices in zip(axes.T[1:], picks, faces, strict=True):
        draw_face(above, mesh, vertices, props=props)
        draw_weights(below, dict(zip(fit.names, fit.weights[i], strict=True)), main, named)
        below.set_title(f"{fit.rms[i]:.3f} mm", fontsize=8)
    axes[1, 1].set_ylabel("weight")
    return figure, axes
