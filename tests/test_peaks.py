"""A mode read off its peak."""

import numpy as np
import pytest

from labnnum.errors import EstimationError
from labnnum.peaks import peak


def one(f, f0, z):
    w, w0 = 2 * np.pi * f, 2 * np.pi * f0
    return -(w**2) * (3 + 0.4j) / (w0**2 - w**2 + 2j * z * w0 * w) + 20 - 3j + 0.3 * w


@pytest.mark.parametrize(("f0", "z"), [(7.31, 0.005), (7.05, 0.02)])
def test_frequency_and_damping_of_one_mode_beside_others(f0, z):
    f = np.arange(5, 10, 0.05)
    found = peak(f, one(f, f0, z), 6.5, 8.0)
    assert found[0] == pytest.approx(f0, rel=1e-6)
    assert found[1] == pytest.approx(z, rel=1e-4)


def test_noise_moves_them_little():
    rng = np.random.default_rng(4)
    f = np.arange(5, 10, 0.05)
    h = one(f, 7.2, 0.01)
    h = h + 0.01 * np.abs(h).max() * (rng.normal(size=f.size) + 1j * rng.normal(size=f.size)) / np.sqrt(2)
    found = peak(f, h, 6.5, 8.0)
    assert found[0] == pytest.approx(7.2, abs=0.01)
    assert found[1] == pytest.approx(0.01, rel=0.1)


def test_too_few_lines_are_refused():
    f = np.arange(5, 10, 0.5)
    with pytest.raises(EstimationError, match="8 are needed"):
        peak(f, one(f, 7.2, 0.01), 6.5, 8.0)
    with pytest.raises(EstimationError, match="between 20 and 30 Hz"):
        peak(f, one(f, 7.2, 0.01), 20, 30)
