"""How well action units are carried to another face, and what it costs.

Errors in mm RMS over vertices and units, against the units that the synthetic target actor really
has. An actor's own manner of moving cannot be known from another; so a second target has the
actor's face and the source's manner.
"""

import numpy as np
from setup import milliseconds
from threadpoolctl import threadpool_limits

import facelab
from data_synth.action_units import ActionUnitRig, actor_rig
from data_synth.actors import ACTORS
from data_synth.template import build_template
from facelab.expression import prepare_units, regress_expression
from facelab.expression.transfer import METHODS, IntermediateSpace, SimplifiedRig, UnitCarrier
from facelab.registration.fit import fit_scan

N_VERTICES = 4375
PAIRS = (("M1", "F1"), ("F1", "M2"), ("M2", "F2"), ("F2", "M1"))


def rms(off):
    """Root mean squared length of the last axis' vectors."""
    return float(np.sqrt((off**2).sum(axis=-1).mean()))


def units():
    """A row for each pair of actors."""
    print("mm RMS; units    true size    " + "    ".join(METHODS) + "  register, to the own mesh")
    for a, b in PAIRS:
        source, target = actor_rig(a, N_VERTICES).linear(), actor_rig(b, N_VERTICES)
        manner = ActionUnitRig(build_template(ACTORS[b].anatomy, N_VERTICES), ACTORS[a].style)
        for said, truth in (("own manner", target), ("same manner", manner)):
            off = []
            for method in METHODS:
                carrier = UnitCarrier(source.neutral, target.neutral, method)
                off.append(rms(carrier.carry(source.deltas) - truth.deltas))
            space = IntermediateSpace(source, target.neutral, register=True)
            own = [space.to_target(space.rig.neutral.vertices + d) for d in space.rig.deltas]
            through = rms(np.array(own) - target.neutral.vertices - truth.deltas)
            columns = "".join(f"{x:8.3f}" for x in off)
            print(
                f"{a} to {b}, {said:11} {rms(truth.deltas):10.3f} {columns} {space.fit.rms:9.3f} "
                f"{through:8.3f}",
                flush=True,
            )


def times():
    """Milliseconds for each step."""
    source, target = (actor_rig(a, N_VERTICES).linear() for a in ("M1", "F1"))
    for method in METHODS:
        cost = milliseconds(
            lambda method=method: UnitCarrier(source.neutral, target.neutral, method).carry(
                source.deltas
            ),
            3,
        )
        print(f"{method}: {cost:.0f} ms for {len(source.names)} units")
    print(f"fit_scan: {milliseconds(lambda: fit_scan(source.neutral, target.neutral), 3):.0f} ms")
    space = IntermediateSpace(source, target.neutral, register=True)
    V = space.rig.shape({"AU12L": 1.0})
    space.to_target(V)
    print(f"to the target's own mesh: {milliseconds(lambda: space.to_target(V), 5):.1f} ms a frame")


def identities(n=20):
    """The template fitted to faces of ICT-FaceKit."""
    try:
        ict = facelab.load_ict_facekit(n_identities=n)
    except facelab.DataUnavailable as missing:
        print("without ICT-FaceKit:", missing)
        return
    source = actor_rig("M1", N_VERTICES).linear()
    rng = np.random.default_rng(0)
    modes = np.array(list(ict.identities.values()))
    left = []
    for _ in range(5):
        V = ict.neutral.vertices + np.tensordot(rng.normal(size=n), modes, axes=1)
        left.append(IntermediateSpace(source, ict.neutral.with_vertices(V)).fit.rms)
    print(f"5 faces from the identity modes of ICT-FaceKit: fitted to {np.round(left, 3)} mm RMS")


def simplified():
    """Regression on the full mesh, or on a simplified one that drives the full one."""
    rig = actor_rig("M1", N_VERTICES).linear()
    rng = np.random.default_rng(0)
    w = np.where(rng.random(len(rig.names)) < 0.15, rng.random(len(rig.names)), 0)
    truth = rig.shape(w)
    sketch = truth + rng.normal(scale=0.5, size=truth.shape)
    basis = prepare_units(rig)
    fit = regress_expression(basis, sketch, 0.015)
    cost = milliseconds(lambda: regress_expression(basis, sketch, 0.015).vertices(), 5)
    print(f"full mesh: {cost:.1f} ms, {rms(fit.vertices() - truth):.3f} mm")
    for n in (397, 1000):
        for weights in ("uniform", "cotangent"):
            simple = SimplifiedRig(rig, n, weights=weights)
            small = prepare_units(simple.rig)

            def drive(small=small, simple=simple):
                found = regress_expression(small, sketch[simple.samples], 0.015)
                return simple.drive(found.vertices())

            alone = rms(simple.drive(truth[simple.samples]) - truth)
            print(
                f"{n} vertices, {weights}: {milliseconds(drive, 5):.1f} ms, "
                f"{rms(drive() - truth):.3f} mm (the Laplacian alone {alone:.3f})"
            )


def main():
    """All of it, on one thread."""
    with threadpool_limits(1):
        units()
        times()
        identities()
        simplified()


if __name__ == "__main__":
    main()
