"""A face in the page: the one module that speaks pythreejs, so that a successor can replace it.

Scene units are millimetres, axes those of the head frame. The middle of the face is the scene's
origin: that is where the camera's controls look until a message tells them otherwise, and in Voila
one that is sent before the page is there never arrives.
"""

import numpy as np
import pythreejs as three
from matplotlib.colors import to_rgb
from scipy.spatial.transform import Rotation

from facelab.geometry.mesh import normals_operator, vertex_normals_by
from facelab.looks import Lining
from facelab.plotting import SKIN
from facelab.widgets.props import PropMeshes

_HOVER, _PIN, _TARGET = "#ffffff", (0.05, 0.05, 0.05), (1.0, 0.85, 0.0)
_FOV = 18.0  # degrees: a long lens, so that a face looks as from across a table
_RESERVED_PINS = 8
_MARKER, _MARKER_SIZE = "#12406b", 3.0  # mm, as wide as those that actors wear
_DISC_CORNERS = 14
_RIM = 3.0  # mm: a mouse this near to a lid or lip, but in the opening, is on its rim
JITTER = 0.6
"""A hand that only clicks moves this far, mm: less is no drag."""
_NOWHERE = (0.0, 0.0, -1e6)


for _trait in three.Picker.class_traits(sync=True).values():
    # the kernel need not repeat to the page where its mouse is: a kilobyte less per move
    _trait.tag(echo_update=False)


class FaceView:
    """A shaded face that can be hovered over, taken hold of and morphed.

    The scene is built once; afterwards only buffers of the same shape are replaced.

    Parameters
    ----------
    mesh : TriangleMesh
        The face, millimetres.
    props : iterable of Prop or (TriangleMesh, colors)
        Eyes and teeth (`facelab.looks.face_props`), which follow the face; or still parts, with
        colors of shape (n_vertices, 3), 0 to 1.
    width, height : int
        Size of the canvas, pixels.
    linked_to : FaceView, optional
        A view whose camera this one shares: turning one turns both, at once. The two show faces
        of about the same size, each in the middle, on canvases of the same proportions.

    Attributes
    ----------
    widget : pythreejs.Renderer
        To be displayed.
    on_hover, on_press, on_move, on_release : callable or None
        Called with (vertex or None), (vertex), (offset of shape (3,), millimetres), ().
    along_normal : bool
        Whether a drag moves along the normal of the vertex instead of in the plane of the view;
        the shift key held at the press does the same.

    Raises
    ------
    ValueError
        If the canvas has other proportions than the one it is linked to.
    """

    def __init__(self, mesh, props=(), width=620, height=640, linked_to=None):
        self.mesh = mesh
        self.on_hover = self.on_press = self.on_move = self.on_release = None
        self.along_normal = False
        self._V, self._N = mesh.vertices, None
        self._middle = (self._V.min(axis=0) + self._V.max(axis=0)) / 2
        self._lining = Lining(mesh)
        self._operator = normals_operator(mesh.faces, mesh.n_vertices)
        self._dragging = False
        self._build_face()
        self._build_marks()
        self._reserve_points(0)
        self._props = PropMeshes(props)
        self._plane = three.Mesh(
            three.PlaneBufferGeometry(4000, 4000), three.MeshBasicMaterial(visible=False)
        )
        if linked_to is None:
            self._build_camera(width / height)
        else:
            self._share_camera(linked_to, width / height)
        shown = [self._face, self._marks, self._cloud, self._hover, self._plane]
        head = three.Group(  # all that is told in the head frame
            children=[*shown, *self._props.meshes],
            position=(-self._middle).tolist(),
        )
        self._scene = three.Scene(children=[head, *self._lights()], background="#f4f4f2")
        self._build_pickers()
        self.widget = three.Renderer(
            camera=self._camera,
            scene=self._scene,
            controls=[self._orbit, self._down, self._moved, self._up, self._left],
            antialias=True,
            width=width,
            height=height,
        )
        self._camera.observe(lambda _: self._draw_pins(), names=["position"])

    # --- scene ------------------------------------------------------------------------------------

    def _build_face(self):
        """The face, and in the same buffers its lining and the pin of the drag under way.

        So that pin, line, face and mouth follow the mouse by one message with three numbers.
        """
        self._n = self.mesh.n_vertices
        offsets, ends, triangles = _pin_shape()
        self._pin_offsets, self._pin_ends = offsets, ends
        V = self._with_pin(self._V, self._lining.vertices(self._V), self._V[[0]])
        N = self._with_pin(self._normals(self._V), self._lining.normals, np.zeros((1, 3)))
        attribute = three.BufferAttribute
        self._position, self._normal = attribute(V), attribute(N)
        self._color = attribute(self._skin())
        self._morphs = [attribute(V) for _ in range(3)]
        self._morph_normals = [attribute(N) for _ in range(3)]
        behind = self._n + len(self._lining.normals)
        faces = np.vstack([self.mesh.faces, self._lining.faces + self._n, triangles + behind])
        geometry = three.BufferGeometry(
            attributes={
                "position": self._position,
                "normal": self._normal,
                "color": self._color,
                "index": attribute(faces.ravel().astype(np.uint32), normalized=False),
            },
            morphAttributes={"position": self._morphs, "normal": self._morph_normals},
        )
        material = three.MeshStandardMaterial(
            roughness=0.55,
            metalness=0.0,
            side="DoubleSide",
            vertexColors="VertexColors",
            morphTargets=True,
            morphNormals=True,
        )
        self._face = three.Mesh(geometry, material, morphTargetInfluences=[0.0, 0.0, 0.0])

    def _build_marks(self):
        self._hover = three.Mesh(
            three.SphereBufferGeometry(1.3, 16, 12),
            three.MeshBasicMaterial(color=_HOVER, transparent=True, opacity=0.85),
            visible=False,
        )
        self._marks = three.Group()
        self._pins = np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3)), None
        self._reserve_pins(_RESERVED_PINS)

    def _reserve_pins(self, n_pins):
        self._room = n_pins
        self._ends = three.BufferAttribute(np.zeros((2 * n_pins, 3), np.float32))
        self._end_colors = three.BufferAttribute(np.zeros((2 * n_pins, 3), np.float32))
        ends = three.BufferGeometry(attributes={"position": self._ends, "color": self._end_colors})
        points = three.Points(
            ends,
            three.PointsMaterial(
                size=11,
                sizeAttenuation=False,
                vertexColors="VertexColors",
                depthTest=False,
                map=_disc(),
                alphaTest=0.5,
            ),
            frustumCulled=False,
        )
        lines = three.LineSegments(
            ends, three.LineBasicMaterial(color="#1a1a1a", depthTest=False), frustumCulled=False
        )
        self._marks.children = [lines, points]
        self._marks.visible = False

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
        self._orbit = three.OrbitControls(controlling=self._camera, enablePan=False)

    def _share_camera(self, other, aspect):
        if abs(aspect / other._camera.aspect - 1) > 0.02:
            raise ValueError(
                f"width / height is {aspect:.2f}, but the view it is linked to has "
                f"{other._camera.aspect:.2f}; give both canvases the same proportions."
            )
        # the orbit too: it listens on both canvases and draws both while the mouse moves
        self._camera, self._orbit = other._camera, other._orbit

    def _lights(self):
        key = three.DirectionalLight(color="#fff4e8", intensity=0.55, position=[-250, 300, 500])
        fill = three.DirectionalLight(color="#dfe9ff", intensity=0.28, position=[400, 50, 300])
        return [three.AmbientLight(color="#ffffff", intensity=0.40), key, fill]

    # --- what the mouse does ----------------------------------------------------------------------

    def _build_pickers(self):
        self._down = three.Picker(controlling=self._face, event="mousedown")
        self._moved = three.Picker(controlling=self._face, event="mousemove")
        # the ends of a drag need no picking, only to be noticed
        self._up = three.Picker(controlling=self._plane, event="mouseup")
        self._left = three.Picker(controlling=self._plane, event="mouseleave")
        self._moved.observe(lambda _: self._mouse_moved(), names=["point"])
        for picker, react in (
            (self._down, self._pressed),
            (self._up, self._released),
            (self._left, self._gone),
        ):
            picker.observe(lambda change, r=react: self._notice(change, r), names=["point"])

    def _notice(self, change, react):
        """React to a click, and make a second one at the same place a change again."""
        if tuple(change["new"]) != _NOWHERE:
            react()
            change["owner"].point = _NOWHERE

    def _point(self, picker):
        """Where the mouse met what the picker looks for, in the head frame, shape (3,)."""
        return self._middle + picker.point  # three.js tells it in the scene

    def _picked(self, picker):
        """Vertex of the face under the mouse, or None."""
        if picker.object is not self._face:
            return None
        corners = np.array(picker.face, dtype=int)
        if corners.max() >= self._n:  # the lining, or the pin of the drag under way
            return self._rim_vertex(self._point(picker))
        away = np.linalg.norm(self._V[corners] - self._point(picker), axis=1)
        return int(corners[away.argmin()])

    def _rim_vertex(self, point):
        """Vertex of a lid or lip beside a point of the opening, as the camera sees them, or None.

        A ray that just misses a lid goes on into the opening.
        """
        rim = self._lining.rim
        if not rim.size:
            return None
        off = np.linalg.norm((self._V[rim] - point) @ self._axes()[:2].T, axis=1)
        return int(rim[off.argmin()]) if off.min() < _RIM else None

    def _pressed(self):
        vertex = self._picked(self._down)
        if vertex is None or self._dragging or self.on_press is None:
            return
        self._grab = self._point(self._down)
        self._plane.position = self._grab.tolist()
        self._plane.quaternion = Rotation.from_matrix(self._axes().T).as_quat().tolist()
        shift = bool(self._down.modifiers) and self._down.modifiers[0]
        self._rail = self._rail_of(vertex) if shift or self.along_normal else None
        self._dragging = True
        self._moved.controlling = self._plane  # from here on moves are read off the plane
        self.on_press(vertex)

    def _mouse_moved(self):
        if self._dragging:
            if self._moved.object is self._plane and self.on_move is not None:
                offset = self._point(self._moved) - self._grab
                if self._rail is not None:
                    across, normal = self._rail
                    offset = (offset @ across) * normal
                self.on_move(offset)
            return
        vertex = self._picked(self._moved)
        # on the face the mouse poses, beside it orbits; orbits everywhere where nothing is posed
        self._orbit.enableRotate = vertex is None or self.on_press is None
        if self.on_hover is not None:
            self.on_hover(vertex)

    def _rail_of(self, vertex):
        """For a drag along the normal: the mouse's way that counts, and the normal.

        The vertex stays under the mouse where the normal is seen from the side. Where it points
        at the viewer, moving the mouse up pulls outwards.
        """
        normal = self.normals[vertex].astype(float)
        right, up, _ = self._axes()
        seen = (normal @ right) * right + (normal @ up) * up
        length = np.linalg.norm(seen)
        return (seen / length**2 if length > 0.4 else up), normal

    def _released(self):
        if not self._dragging:
            return
        self._dragging = False
        self._moved.controlling = self._face
        if self.on_release is not None:
            self.on_release()

    def _gone(self):
        """The mouse has left the canvas: a drag ends, nothing is hovered over any more."""
        self._released()
        self._orbit.enableRotate = True
        if self.on_hover is not None:
            self.on_hover(None)

    def end_drag(self):
        """Forget a drag under way, as after an error in it."""
        self._dragging = False
        self._moved.controlling = self._face

    # --- what is shown ----------------------------------------------------------------------------

    def _normals(self, V):
        return _f32(vertex_normals_by(self._operator, V, self.mesh.faces))

    def _with_pin(self, per_vertex, per_lining, per_pin):
        """Values of the face with those of its lining and the pin's vertices below, float32."""
        per_pin = np.broadcast_to(per_pin, self._pin_offsets.shape)
        return _f32(np.vstack([per_vertex, per_lining, per_pin]))

    def _skin(self, colors=None):
        """Vertex colours of face, lining and pin."""
        skin = np.tile(to_rgb(SKIN), (self._n, 1)) if colors is None else np.asarray(colors)
        pin = np.where(self._pin_ends[:, None] > 0, _TARGET, _PIN)
        return self._with_pin(skin, self._lining.colors, pin)

    @property
    def vertices(self):
        """The face as it was last shown, without a morph, shape (n_vertices, 3), millimetres."""
        return self._V

    @property
    def normals(self):
        """Unit normals of it, shape (n_vertices, 3)."""
        if self._N is None:
            self._N = self._normals(self._V)
        return self._N

    def show(self, vertices):
        """Show the face at these positions, shape (n_vertices, 3), millimetres; ends a morph."""
        self._V, self._N = np.asarray(vertices), None
        if any(self._face.morphTargetInfluences):
            self._face.morphTargetInfluences = [0.0, 0.0, 0.0]
        lining = self._lining
        self._position.array = self._with_pin(self._V, lining.vertices(self._V), self._V[[0]])
        self._normal.array = self._with_pin(self.normals, lining.normals, np.zeros((1, 3)))
        self._props.follow(self._V)

    def begin_morph(self, D, vertex, target):
        """Prepare the face on screen to move by D @ t without sending vertices again.

        Parameters
        ----------
        D : ndarray of shape (n_vertices, 3, 3)
            D[:, :, a] is the displacement for one millimetre of t along axis a.
        vertex : int
            Vertex that is held; a pin is drawn from it to its target.
        target : ndarray of shape (3,)
            Where the target is at t = 0, millimetres.
        """
        axes = self._axes()
        ends = np.where(self._pin_ends[:, None] > 0, target, self._V[vertex])
        pin = ends + self._pin_offsets @ axes + 2 * axes[2]  # a little in front of the skin
        still, facing = self.normals, np.broadcast_to(axes[2], pin.shape)
        lining = self._lining
        self._position.array = self._with_pin(self._V, lining.vertices(self._V), pin)
        self._normal.array = self._with_pin(still, lining.normals, facing)
        reach = 5.0  # mm over which the normals are linearised
        for axis in range(3):
            along = np.where(self._pin_ends[:, None] > 0, np.eye(3)[axis], D[vertex, :, axis])
            moved = self._V + D[:, :, axis]
            self._morphs[axis].array = self._with_pin(moved, lining.vertices(moved), pin + along)
            ahead = self._normals(self._V + reach * D[:, :, axis])
            normals = still + (ahead - still) / np.float32(reach)
            self._morph_normals[axis].array = self._with_pin(normals, lining.normals, facing)

    def morph(self, t):
        """Move the face by D @ t, t of shape (3,), millimetres: three numbers on the wire."""
        self._face.morphTargetInfluences = [float(x) for x in t]

    def show_hover(self, position):
        """Mark a point of the face, shape (3,), or nothing for None."""
        if position is not None:
            self._hover.position = [float(x) for x in position]
        if self._hover.visible != (position is not None):
            self._hover.visible = position is not None

    def show_pins(self, vertices, targets, normals=None, colors=None):
        """Draw pins: a dark dot on each vertex, a yellow one on its target, a line between.

        Parameters
        ----------
        vertices, targets : ndarray of shape (n_pins, 3)
            Millimetres.
        normals : ndarray of shape (n_pins, 3), optional
            Outwards at each vertex: pins on the far side of the head are then hidden.
        colors : ndarray of shape (n_pins, 3), optional
            Of the targets, 0 to 1; yellow if left out.
        """
        self._pins = tuple(np.asarray(a, dtype=float) for a in (vertices, targets)) + (
            normals,
            np.tile(_TARGET, (len(vertices), 1)) if colors is None else np.asarray(colors),
        )
        self._draw_pins()

    def _draw_pins(self):
        """Send the pins that can be seen from where the camera stands."""
        vertices, targets, normals, colors = self._pins
        if normals is not None:
            near = ((self._eye - vertices) * normals).sum(axis=1) > 0
            vertices, targets, colors = vertices[near], targets[near], colors[near]
        n_pins = len(vertices)
        if n_pins > self._room:
            self._reserve_pins(2 * n_pins)
        if n_pins:
            spare = np.arange(self._room) % n_pins  # spare pins lie on those that are there
            for buffer, held, wanted in (
                (self._ends, vertices, targets),
                (self._end_colors, np.tile(_PIN, (n_pins, 1)), colors),
            ):
                buffer.array = _f32(np.stack([held[spare], wanted[spare]], axis=1).reshape(-1, 3))
        if self._marks.visible != bool(n_pins):
            self._marks.visible = bool(n_pins)

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
        """Place the camera in this direction from the face, shape (3,), as far away as it is."""
        direction = np.asarray(direction, dtype=float)
        away = np.linalg.norm(self._camera.position)
        self._camera.position = (away * direction / np.linalg.norm(direction)).tolist()
        self._orbit.exec_three_obj_method("update")  # turns it towards the face

    def resize(self, width, height):
        """Give the canvas another size, pixels; the proportions stay as they are."""
        self.widget.width, self.widget.height = width, height

    def paint(self, colors):
        """Colour the face: shape (n_vertices, 3), 0 to 1; None for plain skin."""
        self._color.array = self._skin(colors)

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


def _pin_shape(radius=1.3, half_width=0.3):
    """A pin seen from the front: a disc at each end, and two crossed ribbons between.

    Returns
    -------
    offsets : ndarray of shape (n, 3)
        From the end, along right, up and back, millimetres.
    ends : ndarray of int, shape (n,)
        0 for vertices at the held vertex, 1 for those at the target.
    triangles : ndarray of int, shape (n_triangles, 3)
    """
    angle = 2 * np.pi * np.arange(_DISC_CORNERS) / _DISC_CORNERS
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * radius
    disc = np.vstack([[[0, 0, 0]], ring])
    around = np.arange(1, _DISC_CORNERS + 1)
    fan = np.stack([0 * around, around, np.roll(around, -1)], axis=1)
    wide = half_width * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    offsets = np.vstack([disc, disc + [0, 0, 0.1], wide, wide])
    n = len(disc)
    ends = np.repeat([0, 1, 0, 1], [n, n, 4, 4])
    a, b = 2 * n, 2 * n + 4
    ribbons = [[a, a + 1, b], [a + 1, b + 1, b], [a + 2, a + 3, b + 2], [a + 3, b + 3, b + 2]]
    return offsets, ends, np.vstack([fan, fan + n, ribbons])


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
