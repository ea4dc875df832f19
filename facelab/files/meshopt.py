"""The decoder of EXT_meshopt_compression: vertex attributes, triangles, index sequences, filters.

References
----------
Khronos Group, EXT_meshopt_compression, appendices A (bitstream) and B (filters).
"""

import numpy as np

_DAMAGED = "its compressed data are damaged"


def decode(data, count, stride, mode, filter="NONE"):
    """The bytes of a compressed buffer view.

    Parameters
    ----------
    data : bytes
    count : int
        Elements.
    stride : int
        Bytes of an element.
    mode : {"ATTRIBUTES", "TRIANGLES", "INDICES"}
    filter : {"NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL"}

    Returns
    -------
    ndarray of uint8, shape (count * stride,)

    Raises
    ------
    ValueError
        For damaged data, or a size that the data cannot hold; no memory is taken before that.
    """
    if mode == "ATTRIBUTES":
        return _filtered(_attributes(data, count, stride), filter).ravel()
    indices = (_triangles if mode == "TRIANGLES" else _sequence)(data, count)
    if len(indices) and not 0 <= indices.min() <= indices.max() < 256**stride:
        raise ValueError(_DAMAGED)
    return indices.astype("<u2" if stride == 2 else "<u4").view(np.uint8)


# --- mode 0: attributes ---------------------------------------------------------------------------


def _attributes(data, count, stride):
    """Elements as bytes, shape (count, stride)."""
    tail = max(stride, 32)  # it ends in the element that the first delta is measured from
    in_block = min((8192 // stride) & ~15, 256)
    headers = sum(-(-n // 64) * stride for n in _blocks(count, in_block)) if count < 1 << 31 else 0
    if len(data) < 1 + headers + tail or data[0] != 0xA0 or count >= 1 << 31:
        raise ValueError(_DAMAGED)
    raw = np.frombuffer(data, np.uint8)
    out = np.empty((count, stride), np.uint8)
    last = raw[len(raw) - stride :]
    at, row = 1, 0
    for n in _blocks(count, in_block):
        deltas, at = _block(data, raw, at, -(-n // 16), stride)
        deltas = (deltas >> 1) ^ -(deltas & 1)  # zigzag
        deltas[:, 0] += last
        out[row : row + n] = np.cumsum(deltas[:, :n], axis=1, dtype=np.uint8).T
        last = out[row + n - 1]
        row += n
    if at != len(data) - tail:
        raise ValueError(_DAMAGED)
    return out


def _blocks(count, in_block):
    return [in_block] * (count // in_block) + [count % in_block] * (count % in_block > 0)


def _block(data, raw, at, n_groups, stride):
    """Deltas of one block, shape (stride, 16 * n_groups), and where the next one begins."""
    header = -(-n_groups // 4)
    places = ([], [], [], [])  # of the groups of each way of packing: (which, where)
    end = len(data)
    for byte in range(stride):
        bits = int.from_bytes(data[at : at + header], "little")
        at += header
        for group in range(byte * n_groups, (byte + 1) * n_groups):
            way = bits & 3
            bits >>= 2
            if way == 0:
                continue
            places[way].append((group, at))
            if way == 1:  # 2 bits each; a value with all of them set stands for a byte behind
                packed = int.from_bytes(data[at : at + 4], "big")
                at += 4 + (packed & (packed >> 1) & 0x55555555).bit_count()
            elif way == 2:
                packed = int.from_bytes(data[at : at + 8], "big")
                packed &= packed >> 2
                at += 8 + (packed & (packed >> 1) & 0x1111111111111111).bit_count()
            else:
                at += 16
        if at > end:
            raise ValueError(_DAMAGED)
    deltas = np.zeros((stride * n_groups, 16), np.uint8)
    for way, width in ((1, 2), (2, 4)):
        if places[way]:
            group, where = np.array(places[way]).T
            packed = raw[where[:, None] + np.arange(2 * width)]
            shifts = np.arange(8 - width, -1, -width)
            small = ((packed[:, :, None] >> shifts) & (2**width - 1)).reshape(-1, 16)
            large = small == 2**width - 1
            behind = where[:, None] + 2 * width - 1 + np.cumsum(large, axis=1)
            small = small.astype(np.uint8)
            small[large] = raw[behind[large]]
            deltas[group] = small
    if places[3]:
        group, where = np.array(places[3]).T
        deltas[group] = raw[where[:, None] + np.arange(16)]
    return deltas.reshape(stride, -1), at


# --- modes 1 and 2: indices -----------------------------------------------------------------------


class _Reader:
    """Whole numbers of seven bits a byte, up to where the tail begins."""

    def __init__(self, data, at, end):
        self.data, self.at, self.end = data, at, end

    def byte(self):
        if self.at >= self.end:
            raise ValueError(_DAMAGED)
        self.at += 1
        return self.data[self.at - 1]

    def number(self):
        value = 0
        for shift in range(0, 35, 7):
            byte = self.byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise ValueError(_DAMAGED)


def _unzigzag(value):
    return (value >> 1) ^ -(value & 1)


def _triangles(data, count):
    """Indices of a list of triangles."""
    n = count // 3
    if count % 3 or len(data) < 1 + n + 16 or data[0] != 0xE1:
        raise ValueError(_DAMAGED)
    codes, table = data[1 : 1 + n], data[len(data) - 16 :]
    more = _Reader(data, 1 + n, len(data) - 16)
    edges, corners = [(0, 0)] * 16, [0] * 16  # the newest last; only 16 are looked at
    ahead = last = 0
    out = []

    def free():
        nonlocal last
        last += _unzigzag(more.number())
        return last

    for code in codes:
        high, low = code >> 4, code & 15
        if high < 15:  # on an edge that was met lately
            a, b = edges[-1 - high]
            if low == 0:
                c = ahead
                ahead += 1
                corners.append(c)
            elif low < 13:
                c = corners[-1 - low]
            else:
                c = last = free() if low == 15 else last + (1 if low == 14 else -1)
                corners.append(c)
            edges += [(c, b), (a, c)]
        else:
            both = table[low] if low < 14 else more.byte()
            if low >= 14 and both == 0:
                ahead = 0
            z, w = both >> 4, both & 15
            if low < 14 and 15 in (z, w):
                raise ValueError(_DAMAGED)
            new = []
            if low == 15:
                a = None  # read below: free indices stand in the order a, b, c
            else:
                a = ahead
                ahead += 1
            b = ahead if z == 0 else corners[-z] if z < 15 else None
            ahead += z == 0
            c = ahead if w == 0 else corners[-w] if w < 15 else None
            ahead += w == 0
            a = free() if a is None else a
            b = free() if b is None else b
            c = free() if c is None else c
            new = [a] + [b] * (z in (0, 15)) + [c] * (w in (0, 15))
            corners += new
            edges += [(b, a), (c, b), (a, c)]
        out += (a, b, c)
        if len(edges) > 4096:
            del edges[:-16], corners[:-16]
    if more.at != more.end:
        raise ValueError(_DAMAGED)
    return np.array(out, dtype=np.int64)


def _sequence(data, count):
    """Indices of any order, each measured from one of two before it."""
    if len(data) < 1 + count + 4 or data[0] != 0xD1:
        raise ValueError(_DAMAGED)
    more = _Reader(data, 1, len(data) - 4)
    last, out = [0, 0], []
    for _ in range(count):
        value = more.number()
        last[value & 1] += _unzigzag(value >> 1)
        out.append(last[value & 1])
    if more.at != more.end:
        raise ValueError(_DAMAGED)
    return np.array(out, dtype=np.int64)


# --- filters --------------------------------------------------------------------------------------


def _filtered(rows, filter):
    stride = rows.shape[1]
    fits = {
        "NONE": True,
        "OCTAHEDRAL": stride in (4, 8),
        "QUATERNION": stride == 8,
        "EXPONENTIAL": stride % 4 == 0,
    }
    if not fits.get(filter):
        raise ValueError(f"its filter {filter!r} is unknown or does not fit {stride} bytes")
    if filter == "OCTAHEDRAL":
        return _octahedral(rows.view(f"<i{stride // 4}")).view(np.uint8)
    if filter == "QUATERNION":
        return _quaternion(rows.view("<i2")).view(np.uint8)
    if filter == "EXPONENTIAL":
        packed = rows.view("<i4")
        with np.errstate(over="ignore"):  # infinite coordinates are refused where they are used
            values = np.ldexp((packed << 8 >> 8).astype(np.float32), packed >> 24)
        return values.astype("<f4").view(np.uint8)
    return rows


def _octahedral(rows):
    """Unit vectors from their shadow on an octahedron."""
    most = np.iinfo(rows.dtype).max
    x, y, one = (rows[:, k].astype(float) for k in range(3))
    one = np.where(one > 0, one, 1)
    x, y = x / one, y / one
    z = 1 - abs(x) - abs(y)
    below = np.minimum(z, 0)
    xyz = np.stack([x - np.copysign(below, x), y - np.copysign(below, y), z], axis=1)
    xyz *= most / np.maximum(np.linalg.norm(xyz, axis=1, keepdims=True), 1e-12)
    out = rows.copy()
    out[:, :3] = _rounded(xyz)
    return out


def _quaternion(rows):
    """Unit quaternions from their three smaller components."""
    one = (rows[:, 3] | 3).astype(float)
    xyz = rows[:, :3] / (np.where(one > 0, one, 1)[:, None] * 2**0.5)
    w = np.sqrt(np.maximum(1 - (xyz**2).sum(axis=1), 0))
    turned = _rounded(np.clip(np.column_stack([w, xyz]), -1, 1) * 32767)
    place = ((rows[:, 3] & 3)[:, None] + np.arange(4)) % 4
    out = np.empty_like(rows)
    np.put_along_axis(out, place.astype(np.intp), turned.astype(rows.dtype), axis=1)
    return out


def _rounded(values):
    return np.trunc(values + np.copysign(0.5, values))
