"""A face in the page: the one module that speaks pythreejs, so that a successor can replace it.

`Hand` sits on its canvas and does in the page what the mouse asks for.

Scene units are millimetres, axes those of the head frame. The middle of the face is the scene's
origin: that is where the camera's controls look until a message tells them otherwise, and in Voila
one that is sent before the page is there never arrives.
"""

from collections import deque
from types import SimpleNamespace

import ipywidgets as widgets
import numpy as np
import pythreejs as three
import scipy.sparse as sp
from matplotlib.colors import to_hex

from facelab.checks import check_choice
from facelab.geometry.mesh import normals_operator, vertex_normals_by
from facelab.looks import Lining, face_props
from facelab.looks.light import FILL, KEY, RIM, STRENGTHS
from facelab.looks.occlusion import skin_colors
from facelab.numeric.undo import in_turn
from facelab.plotting import SKIN
from facelab.widgets.hand import Hand, packed_riders
from facelab.widgets.props import PropMeshes
from facelab.widgets.skin import picture_of, seam_doubles
from facelab.widgets.thumbnail import Thumbnails

_GHOST = "#2f6fd0"
_TARGET = (1.0, 0.85, 0.0)
_FOV = 18.0  # degrees: a long lens, so that a face looks as from across a table
_OVER = 20  # pulls that have ended, of which something may still arrive
_MARKER, _MARKER_SIZE = "#12406b", 3.0  # mm, as wide as those that actors wear


class FaceView:
    """A shaded face that can be hovered over and pulled.

    The scene is built once; afterwards only buffers of the same shape are replaced. While the
    mouse pulls, the page draws the face by itself, from the answer to the press (`begin_pull`).

    Parameters
    ----------
    mesh : TriangleMesh
        The face, millimetres.
    props : iterable of Prop or (TriangleMesh, colors), optional
        Eyes and teeth, which follow the face; or still parts, with colors of shape
        (n_vertices, 3), 0 to 1. If left out, those that `facelab.looks.face_props` makes.
    width, height : int
        Size of the canvas, pixels. It grows with the room that the page has, in proportion.
    linked_to : FaceView, optional
        A view whose camera this one shares: turning one turns both, at once. The two show faces
        of about the same size, each in the middle, on canvases of the same proportions.

    Attributes
    ----------
    widget : ipywidgets.Widget
        To be displayed.
    on_hover, on_press, on_move, on_release : callable or None
        Called with (vertex or None), (vertex), (offset of shape (3,), millimetres), (). Moves are
        told about eight times a second, and the last one always; a hand that only clicks moves
        nothing. Set them before the view is shown.
    lids_off : bool
        Whether lids that would cut an eye are shown outside of it.
    gaze : array_like of shape (2,)
        Where the eyes look from the next `show` on, see `facelab.looks.turn_eyes`.
    look : {"skin", "texture", "wireframe"}
        What the face is drawn with: its colours, the picture of its mesh's `texture`, or edges.

    Raises
    ------
    ValueError
        If the canvas has other proportions than the one it is linked to.

    Examples
    --------
    >>> import facelab
    >>> from facelab.widgets import FaceView
    >>> view = FaceView(facelab.load_template(4375))
    >>> view.names = ["forehead"] * 4375
    >>> view.show_pins({17: view.vertices[17] + [0, 2, 0]})
    """

    def __init__(self, mesh, props=None, width=620, height=640, linked_to=None):
        self.mesh = mesh
        self.on_move = self.on_release = None
        self.lids_off = True
        self._V, self._N = mesh.vertices, None
        self._middle = (self._V.min(axis=0) + self._V.max(axis=0)) / 2
        self._lining = Lining(mesh)
        self._doubles, self._pictured, self._uv = seam_doubles(mesh)
        self._operator = normals_operator(mesh.faces, mesh.n_vertices)
        self._proportions = width / height
        self._props = PropMeshes(face_props(mesh) if props is None else props)
        self._props.follow(self._V)  # teeth are in the dark of the mouth from the start
        self._plain = skin_colors(mesh, SKIN, self._props.props)
        self._build_face()
        self._ghost = self._textured = None  # made when they are first wanted
        self._look = "skin"
        self._reserve_points(0)
        if linked_to is None:
            self._build_camera(width / height)
            # what holds any linked view
            self._grip = SimpleNamespace(press=None, hand=None, over=deque(maxlen=_OVER))
        else:
            self._share_camera(linked_to)
        self._head = three.Group(  # all that is told in the head frame
            children=[self._face, self._cloud, *self._props.meshes],
            position=(-self._middle).tolist(),
        )
        self._scene = three.Scene(children=[self._head, *self._lights()], background="#f4f4f2")
        renderer = three.Renderer(
            camera=self._camera,
            scene=self._scene,
            controls=[self._orbit],
            antialias=True,
            width=width,
            height=height,
        )
        self._hand = self._new_hand(renderer, width, height)
        self.on_hover = self.on_press = None
        self.widget = widgets.Box([renderer, self._hand])
        self.widget.add_class("facelab-face")

    # --- scene ------------------------------------------------------------------------------------

    def _build_face(self):
        """The face, and in the same buffers its lining and the doubles at its texture's seams."""
        self._n = self.mesh.n_vertices
        attribute = three.BufferAttribute
        self._position = attribute(self._lined(self._V))
        self._normal = attribute(self._with_lining(self._normals(self._V), self._lining.normals))
        self._color = attribute(self._skin())
        faces = np.vstack([self.mesh.faces, self._lining.faces + self._n])
        geometry = three.BufferGeometry(
            attributes={
                "position": self._position,
                "normal": self._normal,
                "color": self._color,
                "index": attribute(faces.ravel().astype(np.uint32), normalized=False),
            },
        )
        self._face = three.Mesh(geometry, _material(vertexColors="VertexColors"))

    def _build_textured(self):
        """The face as triangles of its picture, and all others; both read the face's buffers."""
        before, after = np.split(self._uv, [self._n])
        between = len(self._lining.colors)  # the lining lies between face and doubles
        uv = np.vstack([before, np.zeros((between, 2)), after])
        pictured = self._pictured + between * (self._pictured >= self._n)
        plain = np.vstack(
            [self.mesh.faces[~self.mesh.texture.painted], self._lining.faces + self._n]
        )
        meshes = []
        shared = {"position": self._position, "normal": self._normal, "color": self._color}
        shared["uv"] = three.BufferAttribute(_f32(uv))
        for faces, material in (
            (pictured, _material(map=picture_of(self.mesh.texture))),
            (plain, _material(vertexColors="VertexColors")),
        ):
            if len(faces):
                index = three.BufferAttribute(faces.ravel().astype(np.uint32), normalized=False)
                geometry = three.BufferGeometry(attributes={**shared, "index": index})
                meshes.append(three.Mesh(geometry, material, frustumCulled=False))
        self._textured = three.Group(children=meshes)
        self._head.children = [*self._head.children, self._textured]

    def _reserve_points(self, n_points):
        self._points = three.BufferAttribute(np.zeros((max(n_points, 1), 3), np.float32))
        material = three.PointsMaterial(
            color=_MARKER,
            # three.js takes the size as if the lens were 90 degrees wide
            size=_MARKER_SIZE / np.tan(np.radians(_FOV / 2)),
            map=_disc(),
            alphaTest=0.5,
        )
        geometry = three.BufferGeometry(attributes={"position": self._points})
        points = three.Points(geometry, material, frustumCulled=False)
        if not hasattr(self, "_cloud"):
            self._cloud = three.Group(visible=False)
        self._cloud.children = [points]

    def _build_camera(self, aspect):
        low, high = self._V.min(axis=0), self._V.max(axis=0)
        half = np.tan(np.radians(_FOV / 2))
        extent = max(high[1] - low[1], (high[0] - low[0]) / aspect)
        away = 1.12 * extent / 2 / half + (high[2] - low[2]) / 2
        self._camera = three.PerspectiveCamera(
            fov=_FOV, aspect=aspect, near=away / 20, far=away * 4, position=[0, 0, float(away)]
        )
        self._away = float(away)
        self._orbit = three.OrbitControls(controlling=self._camera, enablePan=False)

    def _share_camera(self, other):
        if abs(self._proportions / other._proportions - 1) > 0.02:
            raise ValueError(
                f"width / height is {self._proportions:.2f}, but the view it is linked to has "
                f"{other._proportions:.2f}; give both canvases the same proportions."
            )
        self._grip = other._grip
        # the orbit too: it listens on both canvases and draws both while the mouse moves
        self._camera, self._orbit, self._away = other._camera, other._orbit, other._away

    def _lights(self):
        """Three lights, and what comes from all around, a little more from above."""
        shone = (("#fff4e8", KEY, "key"), ("#dfe9ff", FILL, "fill"), ("#ffffff", RIM, "rim"))
        lights = [
            three.DirectionalLight(
                color=color, intensity=STRENGTHS[name], position=(600 * towards).tolist()
            )
            for color, towards, name in shone
        ]
        sky = {
            "color": "#ffffff",
            "groundColor": "#99928c",
            "intensity": 1.25 * STRENGTHS["around"],
        }
        return [three.HemisphereLight(**sky), *lights]

    # --- what the mouse does ----------------------------------------------------------------------

    def _new_hand(self, renderer, width, height):
        here = {
            "renderer": renderer,
            "camera": self._camera,
            "orbit": self._orbit,
            "face": self._face,
            "position": self._position,
            "normal": self._normal,
        }
        ids = {name: widget.model_id for name, widget in here.items()}
        return Hand(
            self._hear,
            ids={**ids, "parts": [part.model_id for part in self._props.meshes]},
            middle=self._middle.tolist(),
            away=self._away,
            n_vertices=self._n,
            n_faces=len(self.mesh.faces),
            rim=self._lining.rim.tolist(),
            riders=packed_riders(*self._riders()),
            size=[width, height],
        )

    def _riders(self):
        """How lining and doubles ride on the face: E and e of E @ V + e, (n, n_vertices) sparse."""
        V, rim = np.zeros_like(self._V), self._lining.rim
        still = self._lining.vertices(V)
        columns = np.zeros((len(still), len(rim)))
        for k, vertex in enumerate(rim):
            V[vertex, 0] = 1
            columns[:, k] = (self._lining.vertices(V) - still)[:, 0]
            V[vertex, 0] = 0
        lining = sp.csr_array(columns)
        shape = len(still), self._n
        E = sp.csr_array((lining.data, rim[lining.indices], lining.indptr), shape)
        n = len(self._doubles)
        same = sp.csr_array((np.ones(n), (np.arange(n), self._doubles)), (n, self._n))
        return sp.vstack([E, same], format="csr"), np.vstack([still, np.zeros((n, 3))])

    @property
    def on_hover(self):
        return self._on_hover

    @on_hover.setter
    def on_hover(self, react):
        self._on_hover, self._hand.hovers = react, react is not None

    @property
    def on_press(self):
        return self._on_press

    @on_press.setter
    def on_press(self, react):
        self._on_press, self._hand.grabs = react, react is not None

    @property
    def along_normal(self):
        """Whether a drag moves along the normal of the vertex instead of in the plane of the view.

        The shift key held at the press does the same.
        """
        return self._hand.along_normal

    @along_normal.setter
    def along_normal(self, on):
        self._hand.along_normal = on

    @property
    def names(self):
        """Names of the vertices that the page shows under the mouse; empty for their numbers."""
        table, code = self._hand.names, np.frombuffer(self._hand.name_of, np.uint32)
        return [table[c] or f"vertex {v}" for v, c in enumerate(code)]

    @names.setter
    def names(self, names):
        if len(names) not in (0, self._n):
            raise ValueError(
                f"names has {len(names)} names, but the face {self._n} vertices; give one for each."
            )
        names = ["" if name == f"vertex {v}" else name for v, name in enumerate(names)]
        table = list(dict.fromkeys(names))
        place = {name: i for i, name in enumerate(table)}
        code = np.array([place[name] for name in names], np.uint32)
        with self._hand.hold_sync():
            self._hand.names, self._hand.name_of = table, code.tobytes()

    @in_turn
    def _hear(self, message):
        """The mouse has done something in the page.

        A kernel hears by several threads, so what a page has sent may come in another order.
        """
        do, press = message["do"], message.get("press")
        if do == "hover":
            if self.on_hover is not None:
                self.on_hover(message["vertex"])
            return
        for release in message.get("before", ()):
            self._hear(release)
        if press in self._grip.over:
            return
        if press != self._grip.press:
            self._let_go(None)
            self._grip.press, self._grip.hand = press, self._hand
            if self.on_press is not None:
                self.on_press(message["vertex"])
        if do == "move":
            self._moved(message["offset"])
        elif do == "release":
            self._let_go(message["offset"])

    def _moved(self, offset):
        if self.dragging and offset is not None and self.on_move is not None:
            self.on_move(np.array(offset, dtype=float))

    def _let_go(self, offset):
        self._moved(offset)
        if self.dragging:  # not if press or move have failed
            press = self._end()
            if self.on_release is not None:
                self.on_release()
            self._grip.hand.settled = press

    def _end(self):
        press, self._grip.press = self._grip.press, None
        self._grip.over.append(press)
        return press

    def begin_pull(self, answer, vertex, target, ahead=(0.0, 0.0, 0.0)):
        """Tell the page how the face on screen follows the mouse, from the press on.

        Parameters
        ----------
        answer : ndarray of shape (n_vertices, 3, 3) or BoundedPull
            What `PosingSession.press` or `Sculpt.press` returned.
        vertex : int or None
            The one that is held; a pin is drawn from it to its target. None if this face only
            follows another one.
        target : ndarray of shape (3,)
            Where the target is before the pull, millimetres.
        ahead : ndarray of shape (3,)
            Further pull of this face, as where it answers to the same pin as another one.
        """
        self._hand.answer(self._grip.press, answer, vertex, target, ahead)

    def begin_slide(self, hold, slider, shares, changes):
        """Tell the page the faces that a slider goes through, until the end of that.

        Parameters
        ----------
        hold : str
            Name of this slide.
        slider : ipywidgets.Widget
            Its `index` says which face it is.
        shares : ndarray of shape (n_faces, n_changes)
        changes : ndarray of shape (n_changes, n_vertices, 3)
            Face i is that on screen now and shares[i] @ changes.
        """
        self._hand.slide(hold, slider, shares, changes)

    def end_slide(self, hold):
        """The page shows what it was sent again."""
        self._hand.settled = hold

    @property
    def dragging(self):
        """Whether the mouse holds the face, here or in a linked view."""
        return self._grip.press is not None

    def end_drag(self):
        """Forget a drag under way, as after an error in it: the page shows what it was sent."""
        if self.dragging:
            self._grip.hand.settled = self._end()

    # --- what is shown ----------------------------------------------------------------------------

    def _normals(self, V):
        return _f32(vertex_normals_by(self._operator, V, self.mesh.faces))

    def _with_lining(self, per_vertex, per_lining):
        return _f32(np.vstack([per_vertex, per_lining, per_vertex[self._doubles]]))

    def _lined(self, V):
        """Positions of the face, and of what rides on it."""
        return self._with_lining(V, self._lining.vertices(V))

    def _skin(self, colors=None):
        """Vertex colours of face and lining."""
        skin = self._plain if colors is None else np.asarray(colors)
        return self._with_lining(skin, self._lining.colors)

    @property
    def vertices(self):
        """The face as it was last shown, shape (n_vertices, 3), millimetres."""
        return self._V

    @property
    def normals(self):
        """Unit normals of it, shape (n_vertices, 3)."""
        if self._N is None:
            self._N = self._normals(self._V)
        return self._N

    def show(self, vertices):
        """Show the face at these positions, shape (n_vertices, 3), millimetres."""
        vertices = np.asarray(vertices)
        self._V, self._N = self._props.lids_off(vertices) if self.lids_off else vertices, None
        self._position.array = self._lined(self._V)
        self._normal.array = self._with_lining(self.normals, self._lining.normals)
        self._props.follow(self._V)

    def show_ghost(self, vertices=None):
        """Show a second, pale face at these positions, (n_vertices, 3), mm; None takes it away."""
        if self._ghost is None and vertices is not None:
            index = three.BufferAttribute(
                self.mesh.faces.ravel().astype(np.uint32), normalized=False
            )
            at = three.BufferAttribute(_f32(vertices))
            geometry = three.BufferGeometry(attributes={"position": at, "index": index})
            material = three.MeshBasicMaterial(
                color=_GHOST, transparent=True, opacity=0.3, depthWrite=False
            )
            self._ghost = three.Mesh(geometry, material)
            self._head.children = [*self._head.children, self._ghost]
        if vertices is not None:
            self._ghost.geometry.attributes["position"].array = _f32(vertices)
        if self._ghost is not None:
            self._ghost.visible = vertices is not None

    @property
    def gaze(self):
        return self._props.gaze

    @gaze.setter
    def gaze(self, gaze):
        self._props.gaze = gaze

    def carry_props(self, vertices):
        """Move eyes and teeth with the face, at (n_vertices, 3), while the page draws its skin."""
        self._props.follow(np.asarray(vertices))

    def show_pins(self, pins, colors=None, names=None, takes=True):
        """Draw pins: a dark dot on each vertex, a coloured one on its target, a line between.

        Parameters
        ----------
        pins : dict of int to array_like of shape (3,)
            Vertex to target, millimetres.
        colors : ndarray of shape (n_pins, 3), optional
            Of the targets, 0 to 1; yellow if left out.
        names : dict of int to str, optional
            Of pins that have one other than that of their vertex.
        takes : bool, default=True
            Whether the mouse takes hold of a pin near it rather than of the skin.
        """
        self._hand.takes_pins = takes
        colors, names = [_TARGET] * len(pins) if colors is None else colors, names or {}
        self._hand.pins = [
            [int(v), np.asarray(target, dtype=float).tolist(), to_hex(color), names.get(v, "")]
            for (v, target), color in zip(pins.items(), colors, strict=True)
        ]

    def show_points(self, positions):
        """Draw a cloud of markers, 3 mm wide.

        Parameters
        ----------
        positions : ndarray of shape (n_points, 3)
            Millimetres; a point with NaN is not drawn.
        """
        positions = np.asarray(positions, dtype=float)
        if positions.ndim != 2 or positions.shape[1] != 3:
            raise ValueError(f"positions has shape {positions.shape}, but must be (n_points, 3).")
        seen = np.isfinite(positions).all(axis=1)
        if seen.any():
            if len(positions) != len(self._points.array):
                self._reserve_points(len(positions))
            # those not seen hide in the first one that is
            at = np.where(seen[:, None], positions, positions[seen.argmax()])
            self._points.array = _f32(at)
        if self._cloud.visible != bool(seen.any()):
            self._cloud.visible = bool(seen.any())

    def look_from(self, direction=(0.0, 0.0, 1.0)):
        """Place the camera in this direction from the face, (3,), where all of it is seen."""
        direction = np.asarray(direction, dtype=float)
        self._camera.position = (self._away * direction / np.linalg.norm(direction)).tolist()
        self._orbit.exec_three_obj_method("update")  # turns it towards the face

    @property
    def look(self):
        """What the face is drawn with: "skin", "texture" or "wireframe"."""
        return self._look

    @look.setter
    def look(self, look):
        check_choice(look, "look", ("skin", "texture", "wireframe"))
        if look == "texture" and not len(self._pictured):
            raise ValueError(
                'look="texture", but the face has none; read one from a GLB, glTF or VRM file.'
            )
        if look == "texture" and self._textured is None:
            self._build_textured()
        self._look = look
        self._face.material.wireframe = look == "wireframe"
        self._face.visible = look != "texture"
        if self._textured is not None:
            self._textured.visible = look == "texture"

    def resize(self, width, height):
        """Give the canvas another size, pixels; the proportions stay as they are."""
        self._hand.size = [width, height]

    def paint(self, colors):
        """Colour the face: shape (n_vertices, 3), 0 to 1; None for plain skin."""
        self._color.array = self._skin(colors)

    def picture(self):
        """The face as it is shown, from the front, for where no page runs: bytes of a PNG."""
        draw = Thumbnails(self.mesh, self._props.props, *self._hand.size)
        return draw.png(self._V, self.gaze, self._color.array[: self._n])

    def project(self, points):
        """Where points fall on the canvas, as the camera stands now.

        Parameters
        ----------
        points : ndarray of shape (n, 3)
            Millimetres.

        Returns
        -------
        ndarray of shape (n, 2)
            Fractions of the width from the left and of the height from the top.
        """
        x, y, z = self._axes() @ (np.atleast_2d(points) - self._eye).T
        depth = -z * np.tan(np.radians(_FOV / 2))
        return np.stack([(1 + x / depth / self._camera.aspect) / 2, (1 - y / depth) / 2], axis=1)

    @property
    def _eye(self):
        """Where the camera stands in the head frame, shape (3,)."""
        return self._middle + self._camera.position

    def _axes(self):
        """Right, up and back as the camera sees them, rows of shape (3, 3).

        From where the camera stands, for its own rotation reaches the kernel late.
        """
        back = np.asarray(self._camera.position) / np.linalg.norm(self._camera.position)
        right = np.cross([0, 1, 0], back)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])


def _material(**options):
    return three.MeshStandardMaterial(roughness=0.55, metalness=0.0, side="DoubleSide", **options)


def _disc(size=32):
    """A round white texture: points are square without one."""
    across = np.linspace(-1, 1, size)
    inside = across[:, None] ** 2 + across**2 < 0.95
    return three.DataTexture(
        data=np.where(inside[..., None], 255, 0).repeat(4, axis=2).astype(np.uint8),
        format="RGBAFormat",
        type="UnsignedByteType",
    )


def _f32(array):
    return np.ascontiguousarray(array, dtype=np.float32)
