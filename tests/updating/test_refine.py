import numpy as np
import pytest

from labnnum.errors import EstimationError
from labnnum.frf import Frf
from labnnum.parameters import Parameter
from labnnum.structures.chain import Chain, Link
from labnnum.updating.covariance import confusions, estimate_covariance, information
from labnnum.updating.noise import Noise, _window_correlation, noise_of, rough_variance
from labnnum.updating.refine import fit, refine

from .cases import LINES, measured, truck, truths

STRUCTURE, OUTPUTS, INPUTS, BANDS = truck()


def test_the_covariance_is_the_inverse_information_where_lines_are_independent():
    frf = measured(STRUCTURE, STRUCTURE.nominal, LINES, OUTPUTS, INPUTS, relative=0.01)
    found = fit(STRUCTURE, frf, bands=BANDS)
    expected = np.linalg.inv(information(found.slope, found.noise))
    assert np.allclose(found.estimate.covariance, expected, rtol=1e-6)


def test_correlated_lines_widen_by_their_integrated_correlation():
    rng = np.random.default_rng(0)
    n = 4000
    slope = np.ones((1, 1, 1, n), complex)
    lags = np.array([1.0, 0.5])
    flat = np.full((1, 1, n), 0.2)
    noise = Noise(flat, 2 / flat, lags, np.arange(n))
    covariance = estimate_covariance(slope, noise)
    errors = (rng.standard_normal((500, n + 1)) + 1j * rng.standard_normal((500, n + 1))) * np.sqrt(0.05)
    shared = errors[:, 1:] + errors[:, :-1]
    means = shared.mean(axis=1).real
    assert covariance[0, 0] == pytest.approx(0.1 / n * 2, rel=1e-3)
    assert means.var() == pytest.approx(covariance[0, 0], rel=0.2)


def test_lines_that_are_missing_share_nothing():
    flat = np.full((1, 1, 50), 0.2)
    slope = np.ones((1, 1, 1, 50), complex)
    dense = estimate_covariance(slope, Noise(flat, 2 / flat, np.array([1.0, 0.5]), np.arange(50)))
    apart = estimate_covariance(slope, Noise(flat, 2 / flat, np.array([1.0, 0.5]), 2 * np.arange(50)))
    assert apart[0, 0] == pytest.approx(0.1 / 50)
    assert dense[0, 0] > 1.9 * apart[0, 0]


def test_the_correlation_of_a_hann_window_without_overlap():
    shape = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(512) / 512)
    assert np.allclose(_window_correlation(shape, 0.0)[:3], [1, 4 / 9, 1 / 36], atol=1e-9)
    assert np.allclose(_window_correlation(np.ones(512), 0.0), [1.0], atol=1e-9)


def test_the_correlation_with_overlap_is_that_of_simulated_errors():
    rng = np.random.default_rng(1)
    n, hop, segments, runs = 64, 32, 400, 60
    shape = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / n)
    lags = np.zeros(3)
    for _ in range(runs):
        x, e = rng.standard_normal((2, hop * (segments + 1)))
        index = np.arange(segments)[:, None] * hop + np.arange(n)
        fx, fe = np.fft.rfft(x[index] * shape), np.fft.rfft(e[index] * shape)
        h = (fx.conj() * fe).sum(axis=0) / (np.abs(fx) ** 2).sum(axis=0)
        h = h[4:-4]
        lags += [np.real((h[k:] * h[: h.size - k].conj()).mean()) for k in range(3)]
    assert np.allclose(lags / lags[0], _window_correlation(shape, 0.5)[:3], atol=0.06)


def test_noise_is_read_off_the_roughness():
    f = np.linspace(1, 100, 4000)
    rng = np.random.default_rng(2)
    h = 1 / (40**2 - f**2 + 0.8j * f)
    scatter = 2e-6
    noisy = h + scatter / np.sqrt(2) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    found = rough_variance(noisy[None, None])
    assert np.median(found) == pytest.approx(scatter**2, rel=0.1)
    with pytest.raises(EstimationError, match="too few"):
        rough_variance(noisy[None, None, :6])


def test_without_a_variance_the_noise_is_estimated_and_said_so():
    theta = truths(STRUCTURE, 1, seed=3)[0]
    fine = np.linspace(1.0, 6.9, 2000)
    frf = measured(STRUCTURE, theta, fine, OUTPUTS, INPUTS, relative=0.01, known=False)
    estimate = refine(STRUCTURE, frf, bands=BANDS)
    assert any("estimated from its roughness" in w for w in estimate.warnings)
    assert np.abs(estimate.value / theta - 1).max() < 0.05
    stated = refine(STRUCTURE, measured(STRUCTURE, theta, fine, OUTPUTS, INPUTS, relative=0.01), bands=BANDS)
    assert np.all(estimate.std < 2 * stated.std)
    assert np.all(estimate.std > 0.5 * stated.std)


def test_what_the_data_cannot_tell_apart_is_named():
    twins = Chain(
        {"1": 1.0},
        (Link("1", "ground", "ka", 0.5), Link("1", "ground", "kb")),
        (Parameter("ka", 100.0, 50.0, 150.0), Parameter("kb", 100.0, 50.0, 150.0)),
    )
    from labnnum.structures.examples import force_at, motion_of

    f = np.linspace(1.0, 4.0, 80)
    frf = measured(twins, [120.0, 90.0], f, (motion_of("1"),), (force_at("1"),), relative=0.01)
    estimate = refine(twins, frf)
    assert any("cannot tell ka and kb apart" in w for w in estimate.warnings)
    assert estimate["ka"] + estimate["kb"] == pytest.approx(210.0, rel=1e-2)
    assert estimate.converged


def test_priors_are_data_when_asked_for():
    frf = measured(STRUCTURE, STRUCTURE.nominal, LINES, OUTPUTS, INPUTS, relative=0.3)
    alone = refine(STRUCTURE, frf, bands=BANDS)
    helped = refine(STRUCTURE, frf, bands=BANDS, prior=True)
    assert (helped.std < alone.std).all()
    assert (helped.std <= [p.spread for p in STRUCTURE.parameters]).all()


def test_confusions_come_worst_first():
    parameters = (Parameter("a", 0, -1, 1, std=1.0), Parameter("b", 0, -1, 1, std=1.0))
    found = confusions(np.diag([4.0, 0.09]), parameters)
    assert found == ((2.0, ("a",)),)


def test_what_is_refused():
    frf = measured(STRUCTURE, STRUCTURE.nominal, LINES, OUTPUTS, INPUTS, relative=0.01)
    value = frf.value.copy()
    value[0, 0, 30] = np.nan
    with pytest.raises(EstimationError, match="not finite at"):
        refine(STRUCTURE, Frf(frf.frequency, value, frf.outputs, frf.inputs, variance=frf.variance), bands=BANDS)
    with pytest.raises(EstimationError, match="cannot determine 5"):
        refine(STRUCTURE, frf.at(slice(20, 22)))
    with pytest.raises(EstimationError, match="variance must be finite"):
        refine(STRUCTURE, Frf(frf.frequency, frf.value, frf.outputs, frf.inputs, variance=frf.variance * np.nan))
    assert noise_of(frf).estimated is False


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("residual", ["complex", "log"])
@pytest.mark.parametrize(("size", "said"), [(1e90, "1e+90"), (1e160, "1e+160"), (1e300, "1e+300")])
def test_an_frf_that_overflows_names_its_channels_and_line(size, said, residual, known):
    frf = measured(STRUCTURE, STRUCTURE.nominal, LINES, OUTPUTS, INPUTS, relative=0.01, known=known)
    value = frf.value.copy()
    value[0, 0, 7] = size
    names = f"{OUTPUTS[0].name}/{INPUTS[0].name}"
    with pytest.raises(EstimationError, match=f"the FRF {names} is {said.replace('+', '.')} at {LINES[7]:g} Hz"):
        refine(STRUCTURE, Frf(frf.frequency, value, OUTPUTS, INPUTS, variance=frf.variance), residual=residual)


def test_an_frf_that_is_not_finite_names_its_channels_and_line():
    frf = measured(STRUCTURE, STRUCTURE.nominal, LINES, OUTPUTS, INPUTS, relative=0.01)
    value = frf.value.copy()
    value[0, 0, 3] = np.nan
    with pytest.raises(EstimationError, match=f"{OUTPUTS[0].name}/{INPUTS[0].name} is not finite at {LINES[3]:g} Hz"):
        refine(STRUCTURE, Frf(LINES, value, OUTPUTS, INPUTS, variance=frf.variance))


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("value", [1e200, np.nan, np.inf])
def test_a_line_outside_the_bands_may_hold_anything(value, known):
    frf = measured(STRUCTURE, STRUCTURE.nominal, LINES, OUTPUTS, INPUTS, relative=0.01, known=known)
    spoilt = frf.value.copy()
    assert not any(b.low <= LINES[7] <= b.high for b in BANDS)
    spoilt[0, 0, 7] = value
    sound = refine(STRUCTURE, frf, bands=BANDS)
    found = refine(STRUCTURE, Frf(LINES, spoilt, OUTPUTS, INPUTS, variance=frf.variance), bands=BANDS)
    assert np.allclose(found.value, sound.value, rtol=0.02 if not known else 1e-6)
