import numpy as np
import pytest

from labnnum.structures.duffing import Duffing
from labnnum.updating.many import bound_deviations, refine_many
from labnnum.updating.sweeps import ScalesBatch, SweepBatch

OSCILLATOR = Duffing(epsilon=0.1)
LINES = (1 + 0.1 * np.linspace(-0.8, 2.4, 24)) / (2 * np.pi)
SETS = np.array([[0.25, 1.5], [0.19, 1.8], [0.31, 1.1]])


@pytest.fixture(params=[ScalesBatch(OSCILLATOR, LINES), SweepBatch(OSCILLATOR, LINES, levels=(0.3, 0.6))])
def batch(request):
    return request.param


def test_slopes_are_those_of_the_response(batch):
    value, slope = batch.sensitivity(SETS)
    assert value.shape == (3, *batch.shape)
    assert np.allclose(value, batch.frf(SETS), rtol=1e-9)
    step = 1e-6
    for j in range(2):
        up, down = SETS.copy(), SETS.copy()
        up[:, j] += step
        down[:, j] -= step
        plain = (batch.frf(up) - batch.frf(down)) / (2 * step)
        smooth = np.abs(plain) < 1e3  # a line that a jump passes has no derivative
        assert smooth.mean() > 0.98
        assert np.allclose(slope[:, j][smooth], plain[smooth], rtol=1e-4, atol=1e-5)


def test_low_level_and_high_level_agree_where_the_response_is_small():
    low = SweepBatch(Duffing(force=1e-4, epsilon=0.1), LINES)
    value = low.frf(SETS)[:, :, 0]
    assert np.allclose(value[:, 0], value[:, 1])
    omega = 2 * np.pi * LINES
    linear = 1 / (1 - omega**2 + 2j * 0.1 * SETS[:, :1] * omega)
    assert np.allclose(value[:, 0], linear, rtol=1e-5)


def test_parameters_come_back_from_forward_and_backward_sweeps(batch):
    start = np.array([[0.26, 1.45], [0.2, 1.75], [0.3, 1.15]])
    found = refine_many(batch, batch.frf(SETS), start, approach=True)
    assert np.allclose(found.value, SETS, rtol=1e-6)


def test_more_levels_tell_more():
    one, two = (SweepBatch(OSCILLATOR, LINES, levels=levels) for levels in ((0.6,), (0.3, 0.6)))
    assert (bound_deviations(two, SETS, 0.01) < bound_deviations(one, SETS, 0.01)).all()


def test_a_set_without_a_solution_does_not_spoil_the_others():
    batch = SweepBatch(OSCILLATOR, LINES)
    bad = np.vstack([SETS, [[-0.1, 1.5]]])  # negative damping
    value, slope = batch.sensitivity(bad)
    assert np.isnan(value[3]).all()
    assert np.isnan(slope[3]).all()
    assert np.allclose(value[:3], batch.frf(SETS), rtol=1e-9)
