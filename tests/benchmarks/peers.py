"""Peers from elsewhere beside our own carrying of expressions to another face, in the same run.

Deformation transfer (Sumner and Popović 2004) is a short version of our own, here alone: it is no
part of facelab (whose `UnitCarrier` rests on the same idea, triangles weighted by area). Both
faces have the same triangles, so that its correspondence is given. Matching by names gives each
unit of the target the weight of the source's unit of the same name; `translate` finds weights of
the same units. The truth is known: a SYNTHETIC actor's face that moves in another's manner. Errors
are mm RMS over vertices and expressions.
"""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from setup import milliseconds
from threadpoolctl import threadpool_limits

from data_synth.action_units import ActionUnitRig, actor_rig
from data_synth.actors import ACTORS
from data_synth.template import build_template
from facelab.expression import translate
from facelab.expression.transfer import IntermediateSpace, UnitCarrier
from facelab.motion import WeightSequence

N_VERTICES = 4375
PAIRS = (("M1", "F1"), ("F1", "M2"), ("M2", "F2"), ("F2", "M1"))
N_EXPRESSIONS = 20


def frames_of(V, faces):
    """Two edges and a scaled normal of each triangle, as columns: (n_faces, 3, 3)."""
    a, b, c = V[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.sqrt(np.linalg.norm(normal, axis=1, keepdims=True))  # their Eq. 1
    return np.stack([b - a, c - a, normal], axis=2)


class DeformationTransfer:
    """Sumner and Popović 2004, section 3, factored once for a pair of faces."""

    def __init__(self, source, target):
        self.source, self.target, self.faces = source.vertices, target.vertices, source.faces
        self.inverse = np.linalg.inv(frames_of(source.vertices, source.faces))
        G = np.linalg.inv(frames_of(target.vertices, target.faces))
        n, m = target.n_vertices, len(self.faces)
        # T_j = [b - a, c - a, d - a] G_j is linear in the corners and in d, one for each triangle
        corners = np.column_stack([self.faces, n + np.arange(m)])
        parts = np.concatenate([-G.sum(axis=1, keepdims=True), G], axis=1)  # of a, b, c, d
        rows = np.broadcast_to(np.arange(3 * m).reshape(m, 1, 3), parts.shape)
        columns = np.broadcast_to(corners[:, :, None], parts.shape)
        entries = parts.ravel(), (rows.ravel(), columns.ravel())
        self.A = sp.csc_array(sp.coo_array(entries, shape=(3 * m, n + m)))
        hold = sp.coo_array((np.full(n, 1e-6), (np.arange(n),) * 2), shape=(n + m,) * 2)
        self.solver = splu(sp.csc_matrix(self.A.T @ self.A + hold))  # place is free: hardly held

    def carry(self, V):
        """The expression V of the source on the target: its triangles deform alike."""
        S = frames_of(V, self.faces) @ self.inverse
        n = len(self.target)
        # what the gradients leave open, the place of the whole, is that of the source's motion
        wanted = self.target + (V - self.source)
        right = self.A.T @ S.transpose(0, 2, 1).reshape(-1, 3)
        right[:n] += 1e-6 * wanted
        return self.solver.solve(right)[:n]


def rms(off):
    """Root mean squared length of the last axis' vectors."""
    return float(np.sqrt((off**2).sum(axis=-1).mean()))


def carried(a, b):
    """Errors of each way for expressions of a few units, the target in the source's manner."""
    source = actor_rig(a, N_VERTICES).linear()
    face = build_template(ACTORS[b].anatomy, N_VERTICES)
    target = ActionUnitRig(face, ACTORS[a].style).linear()
    own = actor_rig(b, N_VERTICES).linear()
    rng = np.random.default_rng(0)
    W = rng.random((N_EXPRESSIONS, len(source.names)))
    W *= rng.random(W.shape) < 4 / W.shape[1]  # four units in each, on average
    truth, moves = _of(W, target.deltas), _of(W, source.deltas)
    rest = source.neutral.vertices
    transfer = DeformationTransfer(source.neutral, target.neutral)
    space = IntermediateSpace(source, target.neutral, register=True)
    theirs = [transfer.carry(rest + d) - target.neutral.vertices for d in moves]
    through = [space.to_target(space.rig.neutral.vertices + d) for d in _of(W, space.rig.deltas)]
    weights = translate(WeightSequence(W, source.names, 30.0), source, own, smooth=0).weights
    ways = {
        "deformation transfer": np.array(theirs),
        "IntermediateSpace, fitted anew": np.array(through) - target.neutral.vertices,
        "UnitCarrier": UnitCarrier(source.neutral, target.neutral).carry(moves),
        "by names": _of(W[:, [source.names.index(n) for n in own.names]], own.deltas),
        "translate": _of(weights, own.deltas),
    }
    return rms(truth), {name: rms(found - truth) for name, found in ways.items()}


def _of(W, deltas):
    return np.tensordot(W, deltas, axes=1)


def main():
    """A row for each pair, ratios, and what each costs."""
    with threadpool_limits(1):
        for a, b in PAIRS:
            size, off = carried(a, b)
            print(f"{a} to {b}, motion of {size:.2f} mm", flush=True)
            peer = off["deformation transfer"]
            for name, error in off.items():
                print(f"    {name:32s} {error:.3f} mm, {error / peer:.2f} of the first", flush=True)
        source, target = (actor_rig(a, N_VERTICES).linear() for a in PAIRS[0])
        pair = source.neutral, target.neutral
        V = source.shape({source.names[0]: 1.0})
        transfer, carrier = DeformationTransfer(*pair), UnitCarrier(*pair)
        D = (V - source.neutral.vertices)[None]
        ours = milliseconds(lambda: carrier.carry(D), 5)
        theirs = milliseconds(lambda: transfer.carry(V), 5)
        print(f"one expression: UnitCarrier {ours:.2f} ms, deformation transfer {theirs:.2f} ms")


if __name__ == "__main__":
    main()
