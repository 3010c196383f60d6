from dataclasses import replace

import numpy as np
import pytest

from labnnum.bands import Band
from labnnum.errors import BandError, ChannelError, ConfigError, ModelError
from labnnum.structures.chain import Chain, Link
from labnnum.updating import Updater, refine
from labnnum.updating.matching import matched
from labnnum.updating.updater import relative_error, resampled

from .cases import LINES, measured, truck, truths

STRUCTURE, OUTPUTS, INPUTS, BANDS = truck()


@pytest.fixture(scope="module")
def updater():
    return Updater.train(STRUCTURE, BANDS, OUTPUTS, INPUTS, LINES, samples=300)


def test_the_network_is_better_than_the_published_one(updater):
    published = np.array([2.86, 0.79, 2.99, 5.30, 2.81])
    assert (updater.validation[0] < 0.1 * published).all()


def test_an_exact_frf_gives_the_exact_parameters(updater):
    for theta in truths(STRUCTURE, 3):
        estimate = updater.estimate(measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS))
        assert np.allclose(estimate.value, theta, rtol=1e-8)
        assert estimate.method == "network + least squares"
        assert estimate.warnings == ()


@pytest.mark.parametrize("refined", [False, True])
def test_errors_have_the_size_that_is_stated(updater, refined):
    standardised = []
    for i, theta in enumerate(truths(STRUCTURE, 60, seed=1)):
        frf = measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS, relative=0.01, seed=i)
        estimate = updater.estimate(frf, refined=refined)
        standardised.append((estimate.value - theta) / estimate.std)
        assert estimate.warnings == ()
    spread = np.sqrt(np.mean(np.square(standardised), axis=0))
    assert (spread > 0.7).all()
    assert (spread < 1.3).all()


@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_a_network_trained_with_less_noise_than_is_measured_says_so_in_its_deviations(noise):
    trained = Updater.train(
        STRUCTURE, BANDS, OUTPUTS, INPUTS, LINES, samples=1500, centres=200, noise=0.005, features="score"
    )
    standardised = []
    for i, theta in enumerate(truths(STRUCTURE, 60, seed=2)):
        frf = measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS, relative=noise, seed=i)
        estimate = trained.network_estimate(frf)
        standardised.append((estimate.value - theta) / estimate.std)
    spread = np.sqrt(np.mean(np.square(standardised), axis=0))
    assert (spread < 1.3).all()
    assert (spread > 0.2).all()
    assert (estimate.std >= (1 - 1e-9) * np.sqrt(np.diag(trained.network.residual))).all()


def like_measured(features="score", samples=1500, centres=200):
    """An updater trained with the random error of a measurement of 0.5 %."""
    like = measured(STRUCTURE, STRUCTURE.nominal, LINES, OUTPUTS, INPUTS, relative=0.005)
    return Updater.train(
        STRUCTURE, BANDS, OUTPUTS, INPUTS, LINES, samples=samples, centres=centres, features=features, like=like
    )


def test_a_measurement_noisier_than_the_one_trained_like_has_wider_deviations():
    trained = like_measured()
    standardised = []
    for i, theta in enumerate(truths(STRUCTURE, 60, seed=2)):
        frf = measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS, relative=0.03, seed=i)
        estimate = trained.network_estimate(frf)
        standardised.append((estimate.value - theta) / estimate.std)
    standardised = np.array(standardised)
    spread = np.sqrt(np.mean(standardised**2, axis=0))
    assert (spread > 0.6).all()
    assert (spread < 1.4).all()
    assert np.mean(np.abs(standardised) < 1.645) > 0.8
    unknown = replace(trained, trained_variance=None).network_estimate(frf)
    assert (unknown.std >= (1 - 1e-9) * estimate.std).all()
    assert (unknown.std < 1.1 * estimate.std).all()


def test_a_measurement_like_the_one_trained_like_adds_nothing_even_on_other_lines():
    trained = like_measured("log", 300, 100)
    frf = measured(STRUCTURE, STRUCTURE.nominal, LINES, OUTPUTS, INPUTS, relative=0.005, seed=4)
    alone = np.sqrt(np.diag(trained.network.residual))
    assert np.allclose(trained.network_estimate(frf).std, alone, rtol=1e-3)
    finer = np.linspace(LINES[0], LINES[-1], 2 * LINES.size)
    frf = measured(STRUCTURE, STRUCTURE.nominal, finer, OUTPUTS, INPUTS, relative=0.005, seed=4)
    assert np.allclose(trained.network_estimate(frf).std, alone, rtol=0.2)


@pytest.mark.parametrize("factor", [0.75, 1.25])
def test_parameters_outside_the_training_are_flagged(updater, factor):
    theta = STRUCTURE.nominal
    theta[0] = (160 if factor > 1 else 100) * factor
    frf = measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS, relative=0.01)
    estimate = updater.estimate(frf)
    assert any("outside the training range" in w for w in estimate.warnings)
    assert any("at its bound" in w for w in estimate.warnings)


def test_a_wrong_structure_is_flagged_and_misfits(updater):
    links = (*STRUCTURE.links, Link("3", "ground", 2e4))
    other = Chain(STRUCTURE.masses, links, STRUCTURE.parameters)
    estimate = updater.estimate(measured(other, STRUCTURE.nominal, LINES, OUTPUTS, INPUTS, relative=0.01))
    assert any("outside the training range" in w for w in estimate.warnings)
    assert any("misfit" in w for w in estimate.warnings)
    assert estimate.chi2 > 2


def test_channels_are_found_by_place_whatever_their_name_sign_and_quantity(updater):
    turned = tuple(replace(c, name="acc", quantity="acceleration", direction="-x") for c in OUTPUTS)
    theta = truths(STRUCTURE, 1)[0]
    estimate = updater.estimate(measured(STRUCTURE, theta, LINES, turned, INPUTS))
    assert np.allclose(estimate.value, theta, rtol=1e-7)


def test_other_lines_are_interpolated_with_a_remark(updater):
    fine = np.linspace(0.9, 7.0, 401)
    theta = truths(STRUCTURE, 1)[0]
    frf = measured(STRUCTURE, theta, fine, OUTPUTS, INPUTS)
    alone = updater.network_estimate(frf)
    assert any("interpolated" in w for w in alone.warnings)
    assert (relative_error(alone.value, theta, np.zeros(5)) < 1).all()
    assert np.allclose(updater.estimate(frf).value, theta, rtol=1e-6)
    assert np.allclose(resampled(frf, LINES).value, measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS).value, rtol=0.01)


def test_a_measurement_that_does_not_fit_is_refused(updater):
    theta = STRUCTURE.nominal
    elsewhere = tuple(replace(c, node="2") for c in OUTPUTS)
    with pytest.raises(ChannelError, match=r"no response at 3:x .*x3 \(2:x\)"):
        updater.estimate(measured(STRUCTURE, theta, LINES, elsewhere, INPUTS))
    with pytest.raises(ChannelError, match="no input at 1:x"):
        matched(measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS), OUTPUTS, (replace(INPUTS[0], quantity="moment"),))
    with pytest.raises(BandError, match="reaches outside"):
        updater.estimate(measured(STRUCTURE, theta, LINES[:130], OUTPUTS, INPUTS))
    with pytest.raises(BandError, match="outside the data"):
        Updater.train(STRUCTURE, (Band(0.5, 2.0),), OUTPUTS, INPUTS, LINES, samples=20)
    with pytest.raises(ConfigError, match="tuned or printed"):
        Updater.train(STRUCTURE, BANDS, OUTPUTS, INPUTS, LINES, samples=40, network="deep")
    rigid = Chain({"1": 1.0}, (Link("1", "ground", 1.0),))
    with pytest.raises(ModelError, match="no free parameter"):
        Updater.train(rigid, BANDS, OUTPUTS, INPUTS, LINES, samples=40)


def test_the_printed_network_can_be_had():
    printed = Updater.train(STRUCTURE, BANDS, OUTPUTS, INPUTS, LINES, samples=300, network="printed")
    assert printed.network.kernel == "exponential"
    theta = truths(STRUCTURE, 1)[0]
    assert np.allclose(printed.estimate(measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS)).value, theta, rtol=1e-7)


def test_refinement_needs_no_network():
    theta = truths(STRUCTURE, 1, seed=2)[0]
    frf = measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS, relative=0.01)
    estimate = refine(STRUCTURE, frf, bands=BANDS)
    assert np.abs((estimate.value - theta) / estimate.std).max() < 4
