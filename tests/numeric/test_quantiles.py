"""Quantiles of tracks with gaps, against numpy's own."""

import numpy as np
import pytest

from facelab.numeric.quantiles import nan_quantile


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.9, 0.95, 1.0])
@pytest.mark.parametrize("shape", [(1, 5), (2, 5), (301, 7), (300, 4, 3)])
def test_quantiles_with_gaps_are_those_of_numpy(share, shape):
    rng = np.random.default_rng(0)
    values = rng.normal(size=shape)
    gaps = rng.uniform(size=shape) < 0.3
    gaps[0] = False  # each track is seen once
    values[gaps] = np.nan
    expected = np.nanquantile(values, share, axis=0)
    np.testing.assert_allclose(nan_quantile(values, share), expected, rtol=1e-14, atol=1e-15)


def test_the_values_given_are_left_alone():
    values = np.array([[3.0], [np.nan], [1.0]])
    nan_quantile(values, 0.5)
    np.testing.assert_array_equal(values, [[3.0], [np.nan], [1.0]])
