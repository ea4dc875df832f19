"""Error of holistic and region models on an unseen take, by components and by parameters."""

import time

import numpy as np
from setup import example_motion

import facelab
from facelab.models.evaluation import error_curves

SIZES = (1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 50)
TOTALS = (10, 20, 30, 50, 70, 100, 150, 200, 300)


def main():
    """Print a table: error against the noisy frames and against the truth, in millimetres."""
    example, _, _, train, noisy, truth = example_motion()
    print(example.about)
    regions = facelab.segment_face(train.resampled(15), random_state=0)
    X, X_test, X_true = (m.displacements() for m in (train, noisy, truth))
    print(f"{regions}; noise floor {0.3 * np.sqrt(3):.3f} mm")
    print(f"{'model':>18} {'components':>10} {'in all':>7} {'noisy':>7} {'truth':>7}   mm")
    whole = facelab.HolisticModel(max(SIZES)).fit(X)
    parts = facelab.RegionModel(regions, max(SIZES)).fit(X)
    for name, model, sizes, spread, beta in (
        ("holistic", whole, SIZES, "each", None),
        ("region, beta 0", parts, SIZES, "each", 0.0),
        ("region, beta 0.5", parts, SIZES, "each", 0.5),
        ("region, total", parts, TOTALS, "total", 0.5),
    ):
        if beta is not None:
            model.set_params(beta=beta)
        start = time.perf_counter()
        family = (model.truncated(n, spread) for n in sizes)
        curves = error_curves(family, X_test, {"noisy": X_test, "truth": X_true})
        seconds = time.perf_counter() - start
        noisy_curve, true_curve = curves.values()
        for row in zip(
            noisy_curve.components, noisy_curve.parameters, noisy_curve.rms, true_curve.rms,
            strict=True,
        ):  # fmt: skip
            print(f"{name:>18} {row[0]:10d} {row[1]:7d} {row[2]:7.3f} {row[3]:7.3f}", flush=True)
        print(f"{'':>18} {len(sizes)} models in {seconds:.1f} s, {len(X_test)} frames")


if __name__ == "__main__":
    main()
