import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labnnum.bands import Band
from labnnum.errors import BandError, ConfigError
from labnnum.frf import Frf
from labnnum.recording import Channel
from labnnum.updating.features import BandIntegrals, LogBands, PairFeatures, SphereBands
from labnnum.updating.kinds import FEATURES, make_features

F = np.linspace(0.0, 10.0, 201)
BANDS = (Band(1.0, 3.0), Band(4.0, 9.0, imag=0.0))


def oscillator(zeta=0.05):
    f0 = np.array([2.01, 2.21])
    return (1 / (1 - (F / f0[:, None]) ** 2 + 2j * zeta * F / f0[:, None]))[:, None, None, :]


@pytest.mark.parametrize("kind", [c.kind for c in FEATURES if issubclass(c, PairFeatures)])
def test_batches_equal_single_frfs(kind):
    h = oscillator()
    features = make_features(kind, BANDS).fitted(F, h)
    many = features(F, h)
    for one, row in zip(h, many, strict=True):
        assert np.allclose(features(F, one), row, rtol=1e-13)


@pytest.mark.parametrize("kind", [c.kind for c in FEATURES if issubclass(c, PairFeatures)])
def test_settings_recreate_the_features(kind):
    h = oscillator()
    features = make_features(kind, BANDS).fitted(F, h)
    again = make_features(kind, features.bands, **features.settings())
    assert again == features


def test_integrals_of_a_constant_are_its_value_times_the_width():
    h = np.full((1, 1, F.size), 2 - 3j)
    assert np.allclose(BandIntegrals(BANDS)(F, h), [4.0, -6.0, 10.0])


def test_log_features_of_a_constant():
    h = np.full((1, 1, F.size), 2j)
    x = LogBands((Band(1.0, 3.0),), parts=1)(F, h)
    assert np.allclose(x[:4], [np.log(2), 0.0, 1.0, np.log(4)])
    assert np.allclose(x[4:], [0.5, np.log(1 / 12)], atol=2e-3)


@settings(max_examples=20, deadline=None)
@given(st.floats(-30, 30), st.floats(-3, 3))
def test_the_sphere_is_bounded_whatever_the_frf(log_size, phase):
    h = oscillator(zeta=0.0)
    h[..., 40] = np.exp(log_size + 1j * phase)
    x = SphereBands(BANDS).fitted(F, oscillator())(F, h)
    assert np.abs(x).max() <= 1 + 1e-12


def test_scaling_the_frf_moves_only_log_magnitudes():
    features = LogBands((Band(1.0, 3.0),), parts=2)
    a, b = features(F, oscillator()), features(F, 10 * oscillator())
    moved = np.abs(b - a).max(axis=0) > 1e-9
    assert moved.tolist() == [True, False, False, True, False, False, True, False, False]


def test_what_is_refused():
    with pytest.raises(ConfigError, match="integrals, log, sphere"):
        make_features("wavelet", BANDS)
    with pytest.raises(ConfigError, match="parts"):
        make_features("log", BANDS, parts=0)
    with pytest.raises(ConfigError, match="fitted"):
        SphereBands(BANDS)(F, oscillator())
    out, push = Channel("a", "acceleration"), Channel("f", "force", "reference")
    with pytest.raises(BandError, match="20, 30"):
        BandIntegrals((Band(20.0, 30.0),)).of(Frf(F, oscillator()[0], (out,), (push,)))
