"""PLY, the Stanford polygon format, text or binary: a strict reader, and a writer."""

import math
import re

import numpy as np

from facelab.checks import as_finite
from facelab.files.parts import MeshFile, check_coordinates, triangles_of
from facelab.files.words import damaged
from facelab.storage import atomic_path, existing_file

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 20  # bytes


def read_ply_file(path, bad_faces="refuse"):
    """All that a PLY file holds: a `MeshFile` without parts.

    Polygons are cut into triangles inside them; triangle strips are unrolled. Every element is
    read, and refused where it does not agree with the header; colours and the like are passed over.

    Parameters
    ----------
    path : str or Path
    bad_faces : {"refuse", "leave out"}
        What to do about faces with fewer than three corners, with a corner twice, or with a
        vertex that does not exist.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing, empty or damaged file; the message names the row.
    """
    path = existing_file(path, "PLY file")
    data = path.read_bytes()
    form, elements, start = _header(path, data)
    rows = _Rows(path, data[start:], form)
    tables = {name: rows.table(name, count, columns) for name, count, columns in elements}
    rows.end()
    vertex = tables.get("vertex", {})
    if not all(axis in vertex and isinstance(vertex[axis], np.ndarray) for axis in "xyz"):
        raise ValueError(f"{path}: no element 'vertex' with the properties x, y and z.")
    V = np.stack([vertex[axis] for axis in "xyz"], axis=1).astype(float)
    if not len(V):
        raise ValueError(f"{path}: it has no vertices; export the mesh again.")
    check_coordinates(V, lambda row: f"{path}, vertex {row}")
    faces = [
        make(path, tables[name], name, V, bad_faces)
        for name, make in (("face", _polygons), ("tristrips", _strips))
        if name in tables
    ]
    F = np.vstack([np.empty((0, 3), dtype=int), *faces])
    if not len(F):
        raise ValueError(
            f"{path}: {len(V)} vertices but no triangles in it; a cloud of points has no surface."
        )
    return MeshFile(path, V, F)


def _header(path, data):
    """The number format, the elements as (name, count, properties), and where the rows begin."""
    found = re.search(rb"(?:^|[\r\n])end_header[ \t]*(\r\n|\n|\r)", data[:_LONGEST_HEADER])
    if data[:3] != b"ply" or not found:
        raise ValueError(
            f"{path}: not a PLY file; it would begin with 'ply' and have a line 'end_header'."
        )
    lines = data[: found.start()].splitlines()  # of bytes: blanks and ends of ASCII alone
    form, elements = None, []
    for number, line in enumerate(lines[1:], 2):
        words = [word.decode("latin-1") for word in line.split()]
        line = line.decode("latin-1")
        at = f"{path}, line {number}: {line[:80]!r}"
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and form is None:
            form = _FORMATS.get(words[1])
            if form is None or words[2] != "1.0":
                raise ValueError(f"{at}: the format is one of {', '.join(_FORMATS)}, version 1.0.")
        elif words[0] == "element" and len(words) == 3 and re.fullmatch(r"\d{1,15}", words[2]):
            if words[1] in [name for name, _, _ in elements]:
                raise ValueError(f"{at}: the element {words[1]!r} is there twice.")
            elements.append((words[1], int(words[2]), {}))
        elif words[0] == "property" and elements and _property(words) is not None:
            if words[-1] in elements[-1][2]:
                raise ValueError(f"{at}: the property {words[-1]!r} is there twice.")
            elements[-1][2][words[-1]] = _property(words)
        else:
            raise damaged(f"{at} is no line of a PLY header")
    if form is None:
        raise damaged(f"{path}: the header names no format")
    for name, count, columns in elements:
        if count and not columns:
            raise ValueError(f"{path}: element {name!r} has {count} rows but no properties.")
    return form, elements, found.end()


def _property(words):
    """Types of a property: (type,), or (count, type) of a list; None if it is none."""
    if len(words) == 5 and words[1] == "list":
        types = words[2:4]
    else:
        types = words[1:2] if len(words) == 3 else ["none"]
    if not set(types) <= set(_TYPES):
        return None
    types = tuple(_TYPES[t] for t in types)
    return None if len(types) == 2 and types[0][0] == "f" else types


class _Rows:
    """What follows the header: tables of rows, one after the other."""

    def __init__(self, path, body, form):
        self.path, self.form = path, form
        self.body = body if form else [r.split() for r in body.splitlines() if r.strip()]
        self.at = 0  # byte, or row

    def table(self, name, count, columns):
        """Columns of an element: an array, or for a list the values and the count of each row."""
        width = sum(np.dtype(types[0]).itemsize for types in columns.values())
        left = len(self.body) - self.at
        if count * (width if self.form else 1) > left:
            raise damaged(
                f"{self.path}: the file ends early: the header promises {count} rows of {name!r}, "
                f"and {left} {'bytes' if self.form else 'rows'} are left"
            )
        if not count:
            nothing = np.empty(0, dtype=int)
            return {n: nothing if len(t) == 1 else (nothing, nothing) for n, t in columns.items()}
        if not self.form:
            return self._text(name, count, columns)
        alike = self._binary_alike(count, columns)
        return self._binary(name, count, columns) if alike is None else alike

    def end(self):
        """Refuse what follows the last row."""
        left = len(self.body) - self.at
        if left and not (self.form and self.body[self.at :].strip(b"\r\n\0 ") == b""):
            raise ValueError(
                f"{self.path}: {left} {'bytes' if self.form else 'rows'} follow the last row that "
                "the header promises; header and rows disagree, export the file again."
            )

    # --- binary -----------------------------------------------------------------------------------

    def _binary_alike(self, count, columns):
        """All rows at once where their lists are as long as those of the first, else None."""
        fields, at = [], self.at
        for column, types in columns.items():
            kinds = [np.dtype(self.form + t) for t in types]
            n = ()
            if len(types) == 2:
                n = (self._count(at, kinds[0]),)
                at += kinds[0].itemsize
                fields.append((f"number of {column}", kinds[0]))  # no column has blanks
            at += kinds[-1].itemsize * math.prod(n)
            fields.append((column, kinds[-1], n))
            if min(n, default=0) < 0 or at > len(self.body):
                return None
        if self.at + (at - self.at) * count > len(self.body):
            return None
        rows = np.frombuffer(self.body, np.dtype(fields), count, self.at)
        lengths = {c: rows[f"number of {c}"] for c, types in columns.items() if len(types) == 2}
        if any((n != n[0]).any() for n in lengths.values()):
            return None
        self.at += rows.nbytes
        return {
            c: (rows[c].ravel(), lengths[c].astype(int)) if c in lengths else rows[c]
            for c in columns
        }

    def _count(self, at, kind):
        """The whole number that stands at a byte."""
        order = "big" if self.form == ">" else "little"
        stored = self.body[at : at + kind.itemsize]
        return int.from_bytes(stored, order, signed=kind.kind == "i")

    def _binary(self, name, count, columns):
        """Lists of many lengths: find where each row's stand, then take them out at once."""
        kinds = {c: tuple(np.dtype(self.form + t) for t in types) for c, types in columns.items()}
        where = {c: np.empty(count, dtype=np.int64) for c in columns}
        length = {c: np.ones(count, dtype=np.int64) for c in columns}
        at = self.at
        for row in range(count):
            for column, types in kinds.items():
                step = types[-1].itemsize
                if len(types) == 2:
                    length[column][row] = n_items = self._count(at, types[0])
                    at += types[0].itemsize
                    step *= n_items
                if step < 0 or at + step > len(self.body):
                    raise damaged(f"{self.path}: row {row} of {name!r} does not fit into the file")
                where[column][row] = at
                at += step
        self.at = at
        raw, out = np.frombuffer(self.body, np.uint8), {}
        for column, types in kinds.items():
            kind, n = types[-1], length[column]
            begin = np.repeat(where[column], n) + kind.itemsize * _within(n)
            values = raw[begin[:, None] + np.arange(kind.itemsize)].copy().view(kind).ravel()
            out[column] = (values, n) if len(types) == 2 else values
        return out

    # --- text -------------------------------------------------------------------------------------

    def _text(self, name, count, columns):
        rows = self.body[self.at : self.at + count]
        self.at += count
        ends = np.cumsum([len(row) for row in rows])
        at = ends - [len(row) for row in rows]  # the next word of each row
        words = [word for row in rows for word in row]
        values = self._numbers(name, words, ends)

        def take(where, kind):
            found = values[where]
            if kind[0] == "f":
                return found
            limits = np.iinfo(kind)
            odd = (found != np.floor(found)) | (found < limits.min) | (found > limits.max)
            if odd.any():
                self._refuse_word(
                    name, words, ends, where[odd.argmax()], "whole number of its type"
                )
            return found.astype(np.int64)

        out = {}
        for column, types in columns.items():
            self._check_length(name, at >= ends, rows)
            if len(types) == 2:
                n, at = take(at, types[0]), at + 1
                self._check_length(name, (n < 0) | (at + n > ends), rows)
                out[column] = take(np.repeat(at, n) + _within(n), types[1]), n
                at = at + n
            else:
                out[column], at = take(at, types[0]), at + 1
        self._check_length(name, at != ends, rows)
        return out

    def _numbers(self, name, words, ends):
        if b"_" not in b"".join(words):
            try:
                return np.array(words, dtype=float)
            except ValueError:
                pass  # below it is said where
        at = next(i for i, word in enumerate(words) if not _is_number(word))
        self._refuse_word(name, words, ends, at, "number")

    def _refuse_word(self, name, words, ends, at, wanted):
        row = int(np.searchsorted(ends, at, side="right"))
        raise ValueError(
            f"{self.path}: row {row} of {name!r} has {words[at].decode(errors='replace')!r}, "
            f"which is no {wanted}."
        )

    def _check_length(self, name, wrong, rows):
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            text = b" ".join(rows[row]).decode(errors="replace")[:60]
            raise damaged(
                f"{self.path}: row {row} of {name!r}, {text!r}, has not as many values as the "
                "header and its own counts promise"
            )


def _within(counts):
    """0, 1, ... in each of several lists, one after the other."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def _is_number(word):
    try:
        return b"_" not in word and float(word) is not None
    except ValueError:
        return False


def _index_list(path, table, name):
    """The list of vertices in a table: values, counts."""
    for column in ("vertex_indices", "vertex_index"):
        if isinstance(table.get(column), tuple):
            values, counts = table[column]
            if values.dtype.kind == "f" and len(values):
                raise ValueError(f"{path}: the vertices of {name!r} are not whole numbers.")
            return values.astype(np.int64), counts
    raise ValueError(f"{path}: element {name!r} has no list 'vertex_indices'.")


def _polygons(path, table, name, V, bad_faces):
    corners, counts = _index_list(path, table, name)
    if not len(counts):
        return np.empty((0, 3), dtype=int)
    return triangles_of(
        path, V, corners, counts, bad_faces,
        place=lambda k: f"face {k}",
        lacks=lambda at: f"vertex {corners[at]} is not among 0 to {len(V) - 1}",
        words=("it has {} corner(s)", "it uses a vertex twice"),
    )[0]  # fmt: skip


def _strips(path, table, name, V, bad_faces):
    """Triangles of strips, which -1 parts; every second one runs the other way round.

    A triangle that uses a vertex twice only turns a strip round a corner: it has no area.
    """
    values, counts = _index_list(path, table, name)
    out = np.flatnonzero((values < -1) | (values >= len(V)))
    if out.size:
        raise ValueError(
            f"{path}: a strip names vertex {values[out[0]]}, which is not among 0 to {len(V) - 1}; "
            "-1 parts strips."
        )
    ends = np.zeros(len(values) + 1, dtype=bool)
    ends[np.cumsum(counts)] = True  # a list ends a strip as -1 does
    ends = ends[:-1]
    apart = values < 0
    strip = np.cumsum(apart | ends)
    place = np.arange(len(values))
    first = np.maximum.accumulate(np.where(apart, place + 1, np.where(ends, place, 0)))
    F = np.stack([values[:-2], values[1:-1], values[2:]], axis=1)
    whole = (F >= 0).all(axis=1) & (strip[:-2] == strip[2:])
    odd = (place - first)[:-2] % 2 == 1
    F[odd] = F[odd][:, [1, 0, 2]]
    F = F[whole]
    return F[(F != np.roll(F, 1, axis=1)).all(axis=1)]


def write_ply(path, mesh, colors=None):
    """Write a mesh as binary PLY, whole or not at all; positions in float32, millimetres.

    Parameters
    ----------
    path : str or Path
    mesh : TriangleMesh
    colors : ndarray of shape (n_vertices, 3), optional
        Of the vertices, 0 to 1.

    Raises
    ------
    ValueError, TypeError
        For colours of another number or beyond 0 to 1; nothing is written.
    """
    point = [(axis, "<f4") for axis in "xyz"]
    if colors is not None:
        colors = as_finite(colors, "colors", (mesh.n_vertices, 3))
        if colors.min() < 0 or colors.max() > 1:
            raise ValueError("colors holds values beyond 0 to 1; give shares of red, green, blue.")
        point += [(name, "u1") for name in ("red", "green", "blue")]
        colors = np.round(255 * colors)
    columns = [*mesh.vertices.T, *([] if colors is None else colors.T)]
    points = np.empty(mesh.n_vertices, dtype=point)
    for (name, _), column in zip(point, columns, strict=True):
        points[name] = column
    rows = np.empty(len(mesh.faces), dtype=[("n", "u1"), ("v", "<i4", (3,))])
    rows["n"], rows["v"] = 3, mesh.faces
    kinds = {"<f4": "float", "u1": "uchar"}
    head = (
        "ply\nformat binary_little_endian 1.0\ncomment facelab; unit: millimetre\n"
        f"element vertex {mesh.n_vertices}\n"
        + "".join(f"property {kinds[kind]} {name}\n" for name, kind in point)
        + f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with atomic_path(path) as part:
        part.write_bytes(head.encode() + points.tobytes() + rows.tobytes())
