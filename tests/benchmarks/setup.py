"""What the benchmarks share: the example face at several sizes, and a stopwatch."""

import time

import numpy as np

import facelab


def example_motion(samples=397, noise=0.3):
    """Example, samples, control rig, noisy training and test motion, true test motion."""
    example = facelab.load_example()
    corners = [example.rig.neutral.landmarks[f"mouth_corner_{s}"] for s in ("left", "right")]
    index, control = example.rig.neutral.subsample(samples, keep=corners)
    rig = example.rig.on(index, control)
    rng = np.random.default_rng(0)
    truth = rig.animate(example.test)
    train = rig.animate(example.train).with_noise(noise, rng)
    return example, index, rig, train, truth.with_noise(noise, rng), truth


def milliseconds(work, repeats=50):
    """Median time of a call, ms."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))
