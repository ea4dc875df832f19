"""Eyes and teeth in the page: meshes beside the face, which follow it when it is shown anew."""

import numpy as np
import pythreejs as three

from facelab.geometry.mesh import vertex_normals
from facelab.looks import lids_off, shown, turn_eyes

_SEEN = 0.02  # of a colour: less need not be sent


class PropMeshes:
    """What is shown beside a face.

    Parameters
    ----------
    props : iterable of Prop or (TriangleMesh, colors)
        Pairs are still parts.

    Attributes
    ----------
    meshes : list of pythreejs.Mesh
    props : list
        As they were given.
    gaze : array_like of shape (2,)
        Where eyes look when they next follow, see `facelab.looks.turn_eyes`.
    """

    def __init__(self, props):
        self.meshes, self._moving, self.props = [], [], list(props)
        self.gaze = 0.0, 0.0
        for prop in self.props:
            mesh, colors = prop
            buffers = [
                three.BufferAttribute(_f32(x)) for x in (mesh.vertices, mesh.normals, colors)
            ]
            self.meshes.append(_mesh(prop, mesh, *buffers))
            if any(getattr(prop, way, None) for way in ("move", "look", "gap")):
                self._moving.append((prop, mesh.faces, *buffers))

    def lids_off(self, vertices):
        """A posed face with its lids off the eyes, shape (n, 3), millimetres."""
        return lids_off(self.props, vertices)

    def follow(self, vertices):
        """Move them with a face at `vertices`, shape (n, 3), millimetres."""
        for prop, faces, position, normal, color in self._moving:
            (turned,) = turn_eyes([prop], self.gaze)
            V, colors = map(_f32, shown(turned, vertices))
            if not np.array_equal(V, position.array):  # nothing is sent of what rests
                position.array, normal.array = V, _f32(vertex_normals(V, faces))
            if np.abs(colors - color.array).max() > _SEEN:
                color.array = colors


def _mesh(prop, mesh, position, normal, color):
    index = three.BufferAttribute(mesh.faces.ravel().astype(np.uint32), normalized=False)
    geometry = three.BufferGeometry(
        attributes={
            "position": position,
            "normal": normal,
            "color": color,
            "index": index,
        }
    )
    # of still parts of a file, the bright ones shine
    gloss = getattr(prop, "gloss", float(np.max(color.array) > 0.5))
    material = three.MeshStandardMaterial(
        vertexColors="VertexColors",
        roughness=1.0 - 0.78 * gloss,
        metalness=0.0,
        side="DoubleSide",
    )
    return three.Mesh(geometry, material, frustumCulled=False)


def _f32(array):
    return np.ascontiguousarray(array, dtype=np.float32)
