"""The stabilisation diagram: poles of the structure come again at every order, those of noise do not."""

import numpy as np
import pytest

from labnnum.stabilisation import DAMPING_STAYS, FREQUENCY_STAYS, lscf, stabilisation, stable_poles

LINES = np.arange(5 * 16, 70 * 16 + 1) / 16
FREQUENCY, DAMPING = np.array([12.0, 27.0, 41.0, 63.0]), np.array([0.01, 0.008, 0.012, 0.01])
SHAPES = np.array([[1.0, 0.6, -0.8, 0.3], [0.7, -0.9, 0.5, 1.0], [-0.6, 1.0, 0.9, -0.4], [0.8, -0.5, 0.6, -1.1]])


def accelerances(frequency, damping, shapes, lines):
    """(n_out, n_f) of shapes (n_modes, n_out), driven at the first place."""
    s, w = 2j * np.pi * lines, 2 * np.pi * np.asarray(frequency)
    modal = 1 / (s**2 + 2 * (damping * w)[:, None] * s + (w**2)[:, None])
    return s**2 * ((shapes * shapes[:, :1]).T @ modal)


def noisy(value, share, seed):
    """The same with noise of a share of each response's RMS, alike on all lines."""
    normal = np.random.default_rng(seed).standard_normal((2, *value.shape)) / np.sqrt(2)
    return value + share * np.sqrt(np.mean(np.abs(value) ** 2, axis=1, keepdims=True)) * (normal[0] + 1j * normal[1])


def beside(diagram, frequency):
    """Whether each pole is one of the structure's, (n,)."""
    off = np.abs(diagram.frequency[:, None] / frequency - 1).min(axis=1)
    return off < FREQUENCY_STAYS


@pytest.mark.parametrize("even", [False, True])
@pytest.mark.parametrize("seed", range(2))
def test_poles_of_the_structure_stabilise(even, seed):
    value = noisy(accelerances(FREQUENCY, DAMPING, SHAPES, LINES), 3e-3, seed)
    diagram = stabilisation(2 * np.pi * LINES, value, 40, even)
    for f, z in zip(FREQUENCY, DAMPING, strict=True):
        here = np.abs(diagram.frequency / f - 1) < FREQUENCY_STAYS
        assert np.unique(diagram.order[here]).tolist() == list(range(diagram.order[here].min(), 41, 2))
        assert diagram.order[here].min() <= 12
        assert diagram.stable[here & (diagram.order >= 20)].mean() > 0.9
        assert np.median(diagram.damping_ratio[here & diagram.stable]) == pytest.approx(z, rel=0.2)
    np.testing.assert_allclose(stable_poles(diagram)[:, 0], FREQUENCY, rtol=2e-3)


@pytest.mark.parametrize("even", [False, True])
@pytest.mark.parametrize("share", [0.03, 0.3])
def test_poles_of_noise_do_not(even, share):
    """With the highest coefficient fixed those of noise grow instead of decaying, and are left out."""
    value = noisy(accelerances(FREQUENCY, DAMPING, SHAPES, LINES), share, 1)
    diagram = stabilisation(2 * np.pi * LINES, value, 40, even)
    assert diagram.stable.any()
    assert beside(diagram, FREQUENCY)[diagram.stable].all()
    nothing = np.random.default_rng(2).standard_normal((2, *value.shape))
    assert not stabilisation(2 * np.pi * LINES, nothing[0] + 1j * nothing[1], 40, even).stable.any()


def test_a_pole_is_stable_where_one_of_the_order_before_has_its_frequency_and_damping():
    value = noisy(accelerances(FREQUENCY, DAMPING, SHAPES, LINES), 0.1, 5)
    d = stabilisation(2 * np.pi * LINES, value, 20)
    assert set(d.order) <= set(range(4, 21, 2))
    for i in range(d.order.size):
        earlier = d.order == d.order[i] - 2
        f, z = d.frequency[earlier], d.damping_ratio[earlier]
        near = np.abs(f - d.frequency[i]) < FREQUENCY_STAYS * d.frequency[i]
        alike = np.abs(z - d.damping_ratio[i]) < DAMPING_STAYS * max(d.damping_ratio[i], 1e-4)
        assert d.frequency_stays[i] == near.any()
        assert d.stable[i] == (near & alike).any()
        assert d.damping_stays[i] == (f.size > 0 and alike[np.argmin(np.abs(f - d.frequency[i]))])
    assert not d.stable[d.order == d.order.min()].any()
    assert (d.frequency_stays & ~d.stable).any()


@pytest.mark.parametrize("even", [False, True])
def test_without_noise_every_order_above_has_the_poles(even):
    value = accelerances(FREQUENCY, DAMPING, SHAPES, LINES)
    for order in (24, 32):
        found = np.array(lscf(2 * np.pi * LINES, value, order, even))
        for f, z in zip(FREQUENCY, DAMPING, strict=True):
            best = found[np.argmin(np.abs(found[:, 0] - f))]
            assert best[0] == pytest.approx(f, rel=1e-4)
            assert best[1] == pytest.approx(z, rel=1e-2)


def test_two_modes_within_a_half_power_bandwidth_are_two():
    """2 zeta f is the bandwidth; the modes are 0.9 of it apart, and share a column of the diagram."""
    frequency, damping = np.array([15.0, 30.0, 30.27, 57.0]), np.full(4, 0.005)
    value = noisy(accelerances(frequency, damping, SHAPES, LINES), 1e-3, 0)
    found = stable_poles(stabilisation(2 * np.pi * LINES, value, 40, even=True))
    assert len(found) == 4
    np.testing.assert_allclose(found[:, 0], frequency, rtol=1e-3)


def test_noise_that_is_the_same_everywhere_asks_for_even_weights():
    """Damping ratios of 0.03 %: the peaks are narrow, and most lines hold little but noise."""
    lines = np.arange(5 * 64, 70 * 64 + 1) / 64
    damping = np.full(4, 3e-4)
    value = noisy(accelerances(FREQUENCY, damping, SHAPES, lines), 1e-2, 0)
    found = stable_poles(stabilisation(2 * np.pi * lines, value, 40, even=True))
    assert len(found) == 4
    np.testing.assert_allclose(found[:, 0], FREQUENCY, rtol=1e-4)


def test_orders_below_the_first_give_an_empty_diagram():
    value = accelerances(FREQUENCY, DAMPING, SHAPES, LINES)
    diagram = stabilisation(2 * np.pi * LINES, value, 2)
    assert diagram.order.size == diagram.stable.size == 0
    assert stable_poles(diagram).shape == (0, 2)
