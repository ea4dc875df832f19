"""C3D files as other programs write them, byte by byte: any processor, integers or floats."""

import struct

import numpy as np


class Maker:
    """Collects what a file is to say, and writes it; what is not set is written as it should be.

    Parameters
    ----------
    points : ndarray of shape (n_frames, n_points, 3)
        In the file's unit; NaN is written as a hidden point (0, 0, 0, residual -1).
    kind : {"Intel", "DEC", "MIPS"}
    scale : float
        Negative for floats, else worth one integer.
    """

    def __init__(self, points, labels, kind="Intel", scale=-1.0, rate=100.0, units="mm"):
        self.points, self.kind, self.scale, self.rate = np.asarray(points, float), kind, scale, rate
        self.order = ">" if kind == "MIPS" else "<"
        n_frames, n_points, _ = self.points.shape
        self.header = {"points": n_points, "analog": 0, "first": 1, "last": min(n_frames, 65535)}
        self.header |= {"scale": scale, "start": None, "samples": 0, "rate": rate}
        self.parameters = {
            "POINT:USED": n_points, "POINT:SCALE": float(scale), "POINT:RATE": float(rate),
            "POINT:DATA_START": None, "POINT:FRAMES": min(n_frames, 65535),
            "POINT:LABELS": list(labels), "POINT:UNITS": [units],
        }  # fmt: skip
        self.analog = None  # shape (n_frames, values in a frame)
        self.tail = b""
        self.pads = True

    def floats(self, values):
        values = np.atleast_1d(np.asarray(values, dtype=np.float32))
        if self.kind != "DEC":
            return values.astype(f"{self.order}f4").tobytes()
        bits = (values * np.float32(4)).view(np.uint32)
        return np.stack([bits >> 16, bits & 0xFFFF], axis=-1).astype("<u2").tobytes()

    def words(self, values):
        return (np.atleast_1d(values) & 0xFFFF).astype(f"{self.order}u2").tobytes()

    def _record(self, value):
        if isinstance(value, list) and all(isinstance(v, str) for v in value):
            coded = [v.encode("latin-1") for v in value]
            width = max(map(len, coded), default=0)
            return -1, [width, len(coded)], b"".join(v.ljust(width) for v in coded)
        dims = [len(value)] if isinstance(value, list) else []
        if isinstance(np.ravel(value)[0], float):
            return 4, dims, self.floats(value)
        return 2, dims, self.words(value)

    def _section(self, start):
        named = {k: (start if v is None else v) for k, v in self.parameters.items()}
        groups = list(dict.fromkeys(key.split(":")[0] for key in named))
        out = bytes([1, 0x50, 1, {"Intel": 84, "DEC": 85, "MIPS": 86}[self.kind]])
        for number, group in enumerate(groups, 1):
            out += struct.pack("bb", len(group), -number) + group.encode() + self.words([5])
            out += b"\2of"
        for key, value in named.items():
            group, name = key.split(":")
            kind, dims, data = self._record(value)
            body = struct.pack("bB", kind, len(dims)) + bytes(dims) + data + b"\4text"
            out += struct.pack("bb", -len(name), groups.index(group) + 1) + name.encode()
            out += self.words([len(body) + 2]) + body
        return (out + b"\0\0").ljust(-(-(len(out) + 2) // 512) * 512, b"\0")

    def bytes(self):
        size = len(self._section(0))
        start = 2 + size // 512
        section = bytearray(self._section(start))
        section[2] = size // 512
        h = self.header
        words = [h["points"], h["analog"], h["first"], h["last"], 10]
        header = bytes([2, 0x50]) + self.words(words) + self.floats([h["scale"]])
        header += self.words([start if h["start"] is None else h["start"], h["samples"]])
        header += self.floats([h["rate"]])
        n_frames, n_points, _ = self.points.shape
        hidden = np.isnan(self.points).any(axis=2)
        values = np.zeros((n_frames, n_points, 4))
        values[..., :3] = np.where(hidden[..., None], 0, self.points)
        if self.scale > 0:
            values = np.round(values / self.scale).astype(int)
        values[..., 3] = np.where(hidden, -1, 0x0102)  # camera 1, a residual
        values = values.reshape(n_frames, -1)
        if self.analog is not None:
            values = np.concatenate([values, self.analog.astype(values.dtype)], axis=1)
        data = self.floats(values) if self.scale < 0 else self.words(values)
        out = header.ljust(512, b"\0") + bytes(section) + data
        return (out + bytes(-len(out) % 512) if self.pads else out) + self.tail

    def write(self, path):
        path.write_bytes(self.bytes())
        return path
