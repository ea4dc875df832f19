"""PLY, the Stanford polygon format, text or binary: a strict reader, and a writer."""

import re

import numpy as np

from facelab.checks import as_finite, check_choice
from facelab.files.parts import MeshFile, check_coordinates, refuse_bad_faces
from facelab.geometry.polygons import triangulate
from facelab.storage import atomic_path, existing_file

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 20  # bytes
_NUMBERS = re.compile(rb"(?:[-+]?+(?:\d++\.?+\d*+|\.\d++)(?:[eE][-+]?+\d++)?+(?: |\Z))*+")
_WHOLE = re.compile(rb"[-+]?\d{1,18}")


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
    check_choice(bad_faces, "bad_faces", ("refuse", "leave out"))
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
            raise ValueError(f"{at} is no line of a PLY header; export the file again.")
    if form is None:
        raise ValueError(f"{path}: the header names no format; export the file again.")
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
            raise ValueError(
                f"{self.path}: the file ends early: the header promises {count} rows of "
                f"{name!r}, and {left} {'bytes' if self.form else 'rows'} are left; export it "
                "again."
            )
        if not count:
            nothing = np.empty(0)
            return {
                n: nothing if len(t) == 1 else (nothing.astype(int), nothing.astype(int))
                for n, t in columns.items()
            }
        read = self._binary if self.form else self._text
        return read(name, count, columns)

    def end(self):
        """Refuse what follows the last row."""
        left = len(self.body) - self.at
        if left and not (self.form and self.body[self.at :].strip(b"\r\n\0 ") == b""):
            raise ValueError(
                f"{self.path}: {left} {'bytes' if self.form else 'rows'} follow the last row that "
                "the header promises; header and rows disagree, export the file again."
            )

    # --- binary -----------------------------------------------------------------------------------

    def _binary(self, name, count, columns):
        lengths = self._lengths_if_alike(count, columns)
        if lengths is None:
            return self._binary_uneven(name, count, columns)
        fields = []
        for column, types in columns.items():
            if len(types) == 2:
                fields += [(f"#{column}", self.form + types[0])]
                fields += [(column, self.form + types[1], (lengths[column],))]
            else:
                fields += [(column, self.form + types[0])]
        rows = np.frombuffer(self.body, np.dtype(fields), count, self.at)
        self.at += rows.nbytes
        return {
            c: (rows[c].ravel(), np.full(count, lengths[c])) if len(t) == 2 else rows[c]
            for c, t in columns.items()
        }

    def _lengths_if_alike(self, count, columns):
        """Length of each list where all rows are alike, else None."""
        lengths, at, fields = {}, self.at, []
        for column, types in columns.items():
            if len(types) == 2:
                kind = np.dtype(self.form + types[0])
                if at + kind.itemsize > len(self.body):
                    return None
                lengths[column] = n = int(np.frombuffer(self.body, kind, 1, at)[0])
                fields += [(f"#{column}", kind)]
                at += kind.itemsize
                width = np.dtype(types[1]).itemsize * n
            else:
                width = np.dtype(types[0]).itemsize
            if width < 0 or at + width > len(self.body):
                return None
            at += width
            fields += [(column, f"V{width}")] * (width > 0)
        size = at - self.at
        if self.at + size * count > len(self.body):
            return None
        rows = np.frombuffer(self.body, np.dtype(fields), count, self.at)
        alike = all((rows[f"#{column}"] == n).all() for column, n in lengths.items())
        return lengths if alike else None

    def _binary_uneven(self, name, count, columns):
        """Lists of many lengths: find where each row's stand, then take them out at once."""
        kinds = {c: tuple(np.dtype(self.form + t) for t in types) for c, types in columns.items()}
        where = {c: np.empty(count, dtype=np.int64) for c in columns}
        length = {c: np.ones(count, dtype=np.int64) for c in columns}
        order = "big" if self.form == ">" else "little"
        body, at, size = self.body, self.at, len(self.body)
        for row in range(count):
            for column, types in kinds.items():
                if len(types) == 2:
                    n = types[0].itemsize
                    signed = types[0].kind == "i"
                    length[column][row] = n_items = int.from_bytes(
                        body[at : at + n], order, signed=signed
                    )
                    at += n
                    step = n_items * types[1].itemsize
                else:
                    step = types[0].itemsize
                if step < 0 or at + step > size:
                    raise ValueError(
                        f"{self.path}: row {row} of {name!r} does not fit into the file; it was "
                        "cut short or is damaged, export it again."
                    )
                where[column][row] = at
                at += step
        self.at = at
        raw, out = np.frombuffer(body, np.uint8), {}
        for column, types in kinds.items():
            kind, n = types[-1], length[column]
            begin = np.repeat(where[column], n)
            begin += kind.itemsize * (np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n))
            values = raw[begin[:, None] + np.arange(kind.itemsize)].copy().view(kind).ravel()
            out[column] = (values, n) if len(types) == 2 else values
        return out

    # --- text -------------------------------------------------------------------------------------

    def _text(self, name, count, columns):
        rows = self.body[self.at : self.at + count]
        self.at += count
        out = self._text_if_alike(rows, columns)
        if out is not None:
            return out
        out, begin = {}, np.zeros(count, dtype=np.int64)  # of each row's next word
        size = np.array([len(row) for row in rows])
        words = [w for row in rows for w in row]
        start = np.cumsum(size) - size

        def take(where, kind):
            return self._numbers(name, [words[i] for i in where.tolist()], kind, rows, start, where)

        for column, types in columns.items():
            self._check_length(name, begin >= size, rows)
            if len(types) == 2:
                n = take(start + begin, types[0])
                self._check_length(name, (n < 0) | (begin + 1 + n > size), rows)
                first = np.repeat(start + begin + 1, n)
                within = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
                out[column] = take(first + within, types[1]), n
                begin = begin + 1 + n
            else:
                out[column] = take(start + begin, types[0])
                begin = begin + 1
        self._check_length(name, begin != size, rows)
        return out

    def _text_if_alike(self, rows, columns):
        """Columns of rows that all have the same form and hold nothing odd, else None."""
        width = len(rows[0])
        if any(len(row) != width for row in rows):
            return None
        words = [w for row in rows for w in row]
        if not _NUMBERS.fullmatch(b" ".join(words)):
            return None
        values = np.array(words, dtype=float).reshape(-1, width)
        out, at = {}, 0
        for column, types in columns.items():
            n = 1
            if len(types) == 2:
                if at >= width or not 0 <= values[0, at] <= width or np.ptp(values[:, at]):
                    return None
                n, at = int(values[0, at]), at + 1
            part = values[:, at : at + n]
            at += n
            if at > width:
                return None
            if types[-1][0] != "f":
                limits = np.iinfo(types[-1])
                if ((part < limits.min) | (part > limits.max) | (part % 1 != 0)).any():
                    return None
                part = part.astype(np.int64)
            out[column] = (part.ravel(), np.full(len(rows), n)) if len(types) == 2 else part[:, 0]
        return out if at == width else None

    def _check_length(self, name, wrong, rows):
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            text = b" ".join(rows[row]).decode(errors="replace")[:60]
            raise ValueError(
                f"{self.path}: row {row} of {name!r}, {text!r}, has not as many values as the "
                "header and its own counts promise; export the file again."
            )

    def _numbers(self, name, words, kind, rows, start, where):
        try:
            if b"_" in b"".join(words):
                raise ValueError
            if kind[0] == "f":
                return np.array(words, dtype=float)
            if not all(map(_WHOLE.fullmatch, words)):
                raise ValueError
            values = np.array(words, dtype=np.int64)
            limits = np.iinfo(kind)
            if ((values < limits.min) | (values > limits.max)).any():
                raise ValueError
            return values
        except ValueError:
            fits = _fits_float if kind[0] == "f" else _fits_whole(kind)
            at = next(i for i, w in enumerate(words) if not fits(w))
            row = int(np.searchsorted(start, where[at], side="right") - 1)
            raise ValueError(
                f"{self.path}: row {row} of {name!r} has {words[at].decode(errors='replace')!r}, "
                f"which is no {'number' if kind[0] == 'f' else 'whole number of its type'}."
            ) from None


def _fits_float(word):
    try:
        return b"_" not in word and float(word) is not None
    except ValueError:
        return False


def _fits_whole(kind):
    limits = np.iinfo(kind)
    return lambda w: bool(_WHOLE.fullmatch(w)) and limits.min <= int(w) <= limits.max


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
    owner = np.repeat(np.arange(len(counts)), counts)
    reasons = {int(k): f"it has {counts[k]} corner(s)" for k in np.flatnonzero(counts < 3)}
    order = np.lexsort((corners, owner))
    again = (np.diff(corners[order]) == 0) & (np.diff(owner[order]) == 0)
    for k in np.unique(owner[order][1:][again]).tolist():
        reasons.setdefault(k, "it uses a vertex twice")
    for at in np.flatnonzero((corners < 0) | (corners >= len(V)))[::-1].tolist():
        reasons[int(owner[at])] = f"vertex {corners[at]} is not among 0 to {len(V) - 1}"
    places = [(f"face {k}", reasons[k]) for k in sorted(reasons)]
    refuse_bad_faces(path, places, bad_faces, len(counts))
    good = np.ones(len(counts), dtype=bool)
    good[list(reasons)] = False
    if not good.any():
        return np.empty((0, 3), dtype=int)
    try:
        return triangulate(V, corners[np.repeat(good, counts)], counts[good])[0]
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


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
