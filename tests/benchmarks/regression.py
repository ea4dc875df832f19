"""What a regression costs: 101 alphas at once, against `lsq_linear` on the full matrix for each.

The paper gives 1.52 s an expression (MATLAB, 4,375 vertices, 40 units). The literal way is timed
on every twentieth alpha and counted for all 101. Then whole takes, in frames a second.
"""

import time

import numpy as np
from scipy.optimize import lsq_linear
from setup import milliseconds
from threadpoolctl import threadpool_limits

import facelab
from data_synth.action_units import actor_rig
from facelab.expression import prepare_units, regress_expression, regress_sequence

ALPHAS = np.arange(101)


def rigs():
    """The synthetic actor and the faces of ICT-FaceKit, as far as they are at hand."""
    yield actor_rig("M1", 4375).linear()
    try:
        yield facelab.load_ict_facekit()
        yield facelab.load_ict_facekit(area="face")
    except facelab.DataUnavailable as missing:
        print("without ICT-FaceKit:", missing)


def sketch_of(rig):
    """Six units and half a millimetre of noise on each axis."""
    rng = np.random.default_rng(0)
    w = np.zeros(len(rig.names))
    w[rng.permutation(len(w))[:6]] = rng.uniform(0.2, 1, 6)
    V = rig.shape(w)
    return V + rng.normal(scale=0.5, size=V.shape)


def literal(rig, sketch, lam, every=20):
    """Milliseconds for 101 alphas the literal way, and weights at every twentieth."""
    n, K = rig.neutral.n_vertices, len(rig.names)
    D = np.asarray(rig.deltas, dtype=float).reshape(K, -1).T / np.sqrt(n)
    A = np.vstack([D, lam * np.ones(K)])
    d = (sketch - rig.neutral.vertices).ravel() / np.sqrt(n)
    start, W = time.perf_counter(), []
    for alpha in ALPHAS[::every]:
        W.append(lsq_linear(A, np.append(d, lam * alpha), (0, 1), tol=1e-14).x)
    return 1e3 * (time.perf_counter() - start) * len(ALPHAS) / len(W), np.array(W)


def main():
    """Print a row for each rig and lam, then one for each take."""
    print("ms, one thread   units     lam  set-up  one alpha  101 alphas  literal        KKT")
    with threadpool_limits(1):
        for rig in rigs():
            n, K, sketch = rig.neutral.n_vertices, len(rig.names), sketch_of(rig)
            setup = milliseconds(lambda rig=rig: prepare_units(rig), 3)
            basis = prepare_units(rig)
            for lam in (1.0, 1 / np.sqrt(n)):

                def fit(alphas=ALPHAS, basis=basis, sketch=sketch, lam=lam):
                    return regress_expression(basis, sketch, lam, alphas, align=False)

                slow, W = literal(rig, sketch, lam)
                found = fit()
                np.testing.assert_allclose(found.weights[::20], W, atol=1e-6)
                sweep, one = milliseconds(fit), milliseconds(lambda fit=fit: fit([5]))
                print(
                    f"{n:>9} vertices {K:5} {lam:7.3f} {setup:7.0f} {one:10.2f} {sweep:11.2f} "
                    f"{slow:8.0f} ({slow / sweep:.0f}x) {found.kkt.max():.0e}",
                    flush=True,
                )
        takes()


def takes():
    """Frames a second for a recorded take, all its frames at once, with and without occlusion."""
    example = facelab.load_example()
    rig, take = example.rig, example.test[:600]
    motion = rig.animate(take).with_noise(0.3, 0)
    basis = prepare_units(rig)
    seen = np.random.default_rng(0).random(motion.positions.shape[:2]) > 0.1
    for name, visible in (("all seen", None), ("a tenth hidden", seen)):
        start = time.perf_counter()
        found = regress_sequence(basis, motion, visible=visible)
        rate = motion.n_frames / (time.perf_counter() - start)
        off = np.abs(found.weights - rig.rig_weights(take))[take.valid].mean()
        print(
            f"{motion.n_frames} frames of {rig.neutral.n_vertices} vertices, {name}: {rate:.0f} "
            f"frames/s (captured at {motion.fps:g}), mean weight error {off:.4f}"
        )


if __name__ == "__main__":
    main()
