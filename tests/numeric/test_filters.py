import numpy as np
import pytest

from facelab.numeric.filters import one_euro, zero_phase

FPS = 60.0
T = np.arange(600) / FPS


def literal_one_euro(track, fps, cutoff, beta, derivative_cutoff):
    """Algorithm 1 of Casiez et al. 2012 for one track, value by value, in its own words."""

    def alpha(cutoff):
        tau = 1 / (2 * np.pi * cutoff)
        te = 1 / fps
        return 1 / (1 + tau / te)

    first_time, filtered, x_hat, dx_hat = True, [], None, None
    for x in track:
        if first_time:
            first_time, dx, dx_hat, x_hat = False, 0.0, 0.0, x
        else:
            dx = (x - x_hat) * fps
            a = alpha(derivative_cutoff)
            dx_hat = a * dx + (1 - a) * dx_hat
            a = alpha(cutoff + beta * abs(dx_hat))
            x_hat = a * x + (1 - a) * x_hat
        filtered.append(x_hat)
    return filtered


@pytest.mark.parametrize("cutoff, beta, derivative", [(1, 0, 1), (1.5, 3, 1), (0.3, 40, 2)])
def test_one_euro_is_the_algorithm_of_the_paper(rng, cutoff, beta, derivative):
    x = rng.uniform(size=(200, 3)).cumsum(axis=0) * [0.01, 0.1, 1]
    want = np.column_stack([literal_one_euro(c, FPS, cutoff, beta, derivative) for c in x.T])
    np.testing.assert_allclose(one_euro(x, FPS, cutoff, beta, derivative), want, rtol=1e-12)


def test_one_euro_looks_back_only(rng):
    x = rng.uniform(size=(50, 2))
    changed = x.copy()
    changed[30:] = 0
    np.testing.assert_array_equal(one_euro(x, FPS)[:30], one_euro(changed, FPS)[:30])
    assert (one_euro(x, FPS)[30:] != one_euro(changed, FPS)[30:]).all()


def test_one_euro_follows_sooner_with_more_beta_and_shakes_less_with_less_cutoff(rng):
    ramp = np.minimum(T, 1.0)[:, None]
    lag = [np.abs(one_euro(ramp, FPS, 1, beta) - ramp).max() for beta in (0, 1, 5, 50)]
    assert lag == sorted(lag, reverse=True) and lag[-1] < 0.2 * lag[0]
    still = rng.normal(scale=0.01, size=(600, 1))
    shake = [one_euro(still, FPS, cutoff)[100:].std() for cutoff in (20, 5, 1, 0.2)]
    assert shake == sorted(shake, reverse=True) and shake[2] < 0.3 * 0.01


def best_shift(a, b):
    """Frames by which b is late, by the peak of the correlation."""
    shifts = range(-15, 16)
    a, b = a - a.mean(), b - b.mean()
    return max(shifts, key=lambda s: a[100:500] @ b[100 + s : 500 + s])


def test_zero_phase_is_never_late_and_one_euro_is():
    for f in (0.5, 1, 2, 4):
        sine = np.sin(2 * np.pi * f * T)[:, None]
        assert best_shift(sine[:, 0], zero_phase(sine, FPS, 3)[:, 0]) == 0
        assert best_shift(sine[:, 0], one_euro(sine, FPS, 1)[:, 0]) > 0
    ramp = np.column_stack([T, 2 - T])
    np.testing.assert_allclose(zero_phase(ramp, FPS, 3), ramp, atol=1e-6)


@pytest.mark.parametrize("cutoff", [1, 3, 6, 12, 20, 29])
def test_at_the_cut_off_the_root_of_a_half_is_left(cutoff):
    t = np.arange(6000) / FPS  # long, for slow ones
    wave = np.sin(2 * np.pi * cutoff * t + 1)[:, None]
    left = zero_phase(wave, FPS, cutoff)[2000:4000]
    left = np.sqrt((left**2).mean() / (wave[2000:4000] ** 2).mean())
    assert left == pytest.approx(np.sqrt(0.5), rel=2e-3)


def test_what_is_much_slower_stays_and_what_is_much_faster_goes():
    slow, fast = np.sin(2 * np.pi * 0.5 * T), np.sin(2 * np.pi * 25 * T)
    smooth = zero_phase((slow + 0.1 * fast)[:, None], FPS, 6)[:, 0]
    assert np.abs(smooth - slow)[60:-60].max() < 1e-3


def test_zero_phase_read_backwards_is_the_same(rng):
    x = rng.uniform(size=(300, 4))
    forth, back = zero_phase(x, FPS, 4), zero_phase(x[::-1], FPS, 4)[::-1]
    np.testing.assert_allclose(forth[60:-60], back[60:-60], atol=1e-6)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 5, 20])
def test_filters_hold_for_the_shortest_stretches(rng, n):
    x = rng.uniform(size=(n, 2))
    for keep in (lambda x: zero_phase(x, FPS, 6), lambda x: one_euro(x, FPS)):
        assert keep(x).shape == x.shape
        np.testing.assert_allclose(keep(np.full((n, 2), 0.25)), 0.25)


def test_nothing_leaves_its_range(rng):
    x = (rng.uniform(size=(400, 5)) > 0.9).astype(float)
    for smooth in (zero_phase(x, FPS, 8), one_euro(x, FPS, 1, 10)):
        assert 0 <= smooth.min() and smooth.max() <= 1


def test_cut_offs_that_the_rate_does_not_hold_are_refused():
    x = np.zeros((50, 1))
    for cutoff in (0, -1, 30, 31, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"cutoff=.* hertz, but 60 frames a second hold"):
            zero_phase(x, FPS, cutoff)
    for settings, words in (
        ({"cutoff": 0}, "cutoff=0 hertz"),
        ({"derivative_cutoff": np.nan}, "derivative_cutoff=nan"),
        ({"beta": -1}, "beta=-1, but it must be 0 or more"),
    ):
        with pytest.raises(ValueError, match=words):
            one_euro(x, FPS, **settings)
