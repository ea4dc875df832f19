"""Error of holistic and region models on an unseen take, by components and by parameters."""

import numpy as np
from setup import example_motion

import facelab


def main():
    """Print a table: error against the noisy frames and against the truth, in millimetres."""
    example, _, _, train, noisy, truth = example_motion()
    print(example.about)
    regions = facelab.segment_face(train.resampled(15), random_state=0)
    X, X_test, X_true = (m.displacements() for m in (train, noisy, truth))
    print(f"{regions}; noise floor {0.3 * np.sqrt(3):.3f} mm")
    print(
        f"{'components':>10} {'model':>9} {'beta':>5} {'in all':>7} {'noisy':>7} {'truth':>7}   mm"
    )
    for P in (1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 50):
        region = facelab.RegionModel(regions, P).fit(X)
        for model, beta in ((facelab.HolisticModel(P).fit(X), None), (region, 0.0), (region, 0.5)):
            if beta is not None:
                model.set_params(beta=beta)
            X_hat = model.reconstruct(X_test)
            errors = (facelab.rms_error(X_test, X_hat), facelab.rms_error(X_true, X_hat))
            name = "holistic" if beta is None else "region"
            print(
                f"{P:10d} {name:>9} {'' if beta is None else beta:>5} {model.n_coefficients_:7d} "
                f"{errors[0]:7.3f} {errors[1]:7.3f}"
            )


if __name__ == "__main__":
    main()
