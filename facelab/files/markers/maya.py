"""Maya ASCII scenes: the curves of markers in, by a small reader of nothing else."""

import contextlib
import re
from itertools import pairwise

import numpy as np

from facelab.files.markers.rules import (
    checked,
    factor_of,
    marker_sequence,
    resolve_names,
    warn,
)
from facelab.files.words import listed

_RATES = {  # frames a second of Maya's names for units of time
    "game": 15.0, "film": 24.0, "pal": 25.0, "ntsc": 30.0, "show": 48.0, "palf": 50.0,
    "ntscf": 60.0, "millisec": 1000.0, "sec": 1.0,
}  # fmt: skip
_MOST_BYTES = 2**29  # a scene is read whole
_NODE = re.compile(r'createNode (\w+) .*?-n "([^"\n]+)"(?:.*? -p "([^"\n]+)")?')
_KEYS = re.compile(r'setAttr ([^"\n;]*)"\.ktv(?:\[(\d{1,9})(?::(\d{1,9}))?\])?"([^;"]*);')
_TRANSFORM = re.compile(r'setAttr [^"\n;]*"\.(t|r|s|sh|[trs][xyz]|rp|rpt|sp|spt)"([^;"]*);')
_AXES = {"tx": 0, "ty": 1, "tz": 2, "translateX": 0, "translateY": 1, "translateZ": 2}
_STRANGE = re.compile(r"[^0-9eE+\-.\s]")


def read_maya(path, unit=None, fps=None, subject=None):
    """The markers of a Maya ASCII scene (`.ma`): every node that curves move along x, y and z.

    Parameters
    ----------
    path : str or Path
    unit : {"mm", "cm", "dm", "m", "in", "ft"}, optional
        Length unit; else `currentUnit` of the scene.
    fps : float, optional
        Frames a second; else the spacing of the keys.
    subject : str, optional
        Only the nodes of this namespace, where there are several.

    Returns
    -------
    MarkerSequence
        Millimetres, float64, axes as in the scene. A marker without a key in a frame is hidden
        there. `report` says what was left out, renamed and counted.

    Raises
    ------
    FileNotFoundError, ValueError
        Also for markers below a node that is moved, turned or scaled: freeze it in Maya.
    """
    path, fps = checked(path, "Maya scene", unit, fps, subject)
    if path.suffix.lower() != ".ma" or path.stat().st_size > _MOST_BYTES:
        raise ValueError(f"{path}: give a Maya ASCII scene (.ma) of at most 512 MB.")
    text = path.read_bytes().decode("utf-8", "replace").replace("\r\n", "\n")
    if not text.startswith("//Maya ASCII"):
        raise ValueError(f"{path}: not a Maya ASCII scene; it would start with //Maya ASCII.")
    if not text.rstrip().rpartition("\n")[2].startswith("// End of"):
        raise ValueError(
            f"{path}: cut short: its last line should be // End of ...; copy it again."
        )
    scene = _Scene(path, text)
    report = []
    nodes = scene.markers(report)
    labels = [node.rpartition("|")[2] for node in nodes]
    names, kept = resolve_names(path, labels, subject, report)
    nodes = [list(nodes)[i] for i in kept]
    factor = factor_of(path, scene.units.get("l", "centimeter"), unit, "currentUnit -l")
    positions, rate = scene.positions(nodes, report)
    if fps is not None:
        report.append(f"{fps:g} frames/s as said with fps=, not {rate:g}")
    with np.errstate(over="ignore"):
        positions *= factor
    fps = rate if fps is None else fps
    return marker_sequence(path, positions, names, fps, report)


class _Scene:
    """Nodes, their curves and what they are joined by."""

    def __init__(self, path, text):
        self.path = path
        units = re.search(r"(?m)^currentUnit\b.*$", text)
        self.units = dict(re.findall(r"-([lat]) ([\w.]+)", units[0] if units else ""))
        self.parents, self.leaves, self.moved, self.curves = {}, {}, {}, {}
        starts = [m.start() for m in re.finditer(r"(?m)^(?=\w|//)", text)] + [len(text)]
        self.joined = {}
        for a, b in pairwise(starts):
            if text.startswith("createNode", a):
                self._node(text[a:b])
            elif text.startswith("connectAttr", a):
                ends = re.match(r'connectAttr [^"\n]*"([^"\n]+)" "([^"\n]+)"', text[a:b])
                if ends:
                    self._join(*ends.groups())

    def _node(self, text):
        head = _NODE.match(text)
        if head is None:
            return
        kind, name, parent = head.groups()
        if kind == "animCurveTL":
            if name in self.curves:
                raise ValueError(
                    f"{self.path}: two curves are called {name}; save the scene again."
                )
            self.curves[name] = self._keys(name, text)
        elif kind == "transform":
            full = f"{parent.rstrip('|')}|{name}" if parent else name
            self.parents[full] = parent
            self.leaves.setdefault(name, []).append(full)
            self.moved[full] = {
                m[1]: [float(v) for v in re.findall(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?", m[2])][-3:]
                for m in _TRANSFORM.finditer(re.sub(r'-type "\w+"', "", text))
            }

    def _keys(self, name, text):
        """Times and values of a curve, shape (n_keys, 2)."""
        times, wanted = [], None
        for flags, first, last, numbers in _KEYS.findall(text):
            if not first:  # only says how many follow
                count = re.search(r"-s (\d{1,9})\b", flags)
                wanted = int(count[1]) if count else None
                continue
            n = int(last or first) - int(first) + 1
            values = numbers.split()
            pairs = None
            if not _STRANGE.search(numbers) and len(values) == 2 * n and int(first) == len(times):
                with contextlib.suppress(ValueError):
                    pairs = np.array(values, dtype=float).reshape(-1, 2)
            if pairs is None or not np.isfinite(pairs).all():
                raise ValueError(
                    f"{self.path}: damaged: the keys {first} to {last or first} of the curve "
                    f"{name} are not {2 * n} numbers that follow the {len(times)} before; save it "
                    "again."
                )
            times.extend(pairs.tolist())
        keys = np.array(times).reshape(-1, 2)
        if wanted not in (None, len(keys)) or len(keys) == 0:
            raise ValueError(
                f"{self.path}: damaged: the curve {name} has {len(keys)} keys, but "
                f"{'needs one' if wanted is None else f'says {wanted}'}; save it again."
            )
        if (np.diff(keys[:, 0]) <= 0).any():
            raise ValueError(f"{self.path}: damaged: the keys of {name} do not run forwards.")
        return keys

    def _join(self, source, target):
        curve, _, _ = source.rpartition(".")
        node, _, attribute = target.rpartition(".")
        if attribute in _AXES:
            axis = _AXES[attribute]
            axes = self.joined.setdefault(self._full(node), {})
            if axis in axes:
                raise ValueError(f"{self.path}: damaged: two things move {target}; save it again.")
            axes[axis] = curve

    def _full(self, node):
        """The node as `parents` has it: names that are unique stand without their parents."""
        node = node.lstrip("|")
        found = self.leaves.get(node.rpartition("|")[2], [])
        found = [full for full in found if full == node or full.endswith(f"|{node}")]
        return found[0] if len(found) == 1 else node

    def markers(self, report):
        """Nodes that are moved by curves along all axes: {node: [curve of x, y, z]}."""
        markers, others = {}, []
        for node, axes in self.joined.items():
            curves = [axes.get(axis) for axis in range(3)]
            if all(curve in self.curves for curve in curves):
                markers[node] = curves
            else:
                others.append(node)
        if not markers:
            raise ValueError(
                f"{self.path}: no node in it is moved by curves along x, y and z; bake the "
                "animation of the markers."
            )
        used = {curve for curves in markers.values() for curve in curves}
        loose = [curve for curve in self.curves if curve not in used]
        if others:
            said = f"{len(others)} node(s) without curves for x, y and z left out: {listed(others)}"
            warn(self.path, report, said, stacklevel=5)
        if loose:
            report.append(
                f"{len(loose)} curve(s) of nothing that is a marker left out: {listed(loose)}"
            )
        for node in markers:
            self._check_parents(node)
        self.found = markers
        return markers

    def _check_parents(self, node):
        seen, parent = {node}, self.parents.get(node)
        while parent:
            parent = self._full(parent)
            rest = {"s": 1.0, "sx": 1.0, "sy": 1.0, "sz": 1.0}
            moved = any(
                value != rest.get(kind, 0.0)
                for kind, values in self.moved.get(parent, {}).items()
                for value in values
            )
            if moved or parent in self.joined or parent in seen:
                raise ValueError(
                    f"{self.path}: {node} stands below {parent}, which is itself moved, turned or "
                    "scaled; freeze its transformation in Maya, or bake the markers in the world."
                )
            seen.add(parent)
            parent = self.parents.get(parent)

    def positions(self, nodes, report):
        """Positions in units of the scene, shape (n_frames, n_nodes, 3), and frames a second."""
        curves = [[self.curves[curve] for curve in self.found[node]] for node in nodes]
        times = np.unique(np.concatenate([keys[:, 0] for three in curves for keys in three]))
        if len(times) < 2:
            raise ValueError(f"{self.path}: its curves have one key only; that is no motion.")
        step = float(np.median(np.diff(times)))
        slots = np.round((times - times[0]) / step).astype(np.int64)
        off = np.abs((times - times[0]) / step - slots).max()
        if off > 0.05 or (np.diff(slots) < 1).any() or slots[-1] >= 2 * len(times):
            raise ValueError(
                f"{self.path}: its keys do not lie on one beat (of {step:g} frames of Maya); bake "
                "the animation with a key in each frame."
            )
        positions = np.full((int(slots[-1]) + 1, len(nodes), 3), np.nan)
        for i, three in enumerate(curves):
            for axis, keys in enumerate(three):
                positions[slots[np.searchsorted(times, keys[:, 0])], i, axis] = keys[:, 1]
        bare = int(np.isnan(positions).any(axis=2).sum())
        if bare:
            report.append(f"{bare} position(s) without a key taken for hidden")
        named = self.units.get("t", "film")
        found = re.fullmatch(r"(\d+(?:\.\d+)?)(?:fps|df)", named)
        per_second = float(found[1]) if found else _RATES.get(named)
        if not per_second:
            raise ValueError(f"{self.path}: its unit of time, {named!r}, is unknown.")
        return positions, float(f"{per_second / step:.6g}")
