import numpy as np
import pytest

from labnnum.errors import ChannelError, EstimationError
from labnnum.structures.examples import EXAMPLES
from labnnum.updating.modal_data import modal_data, model_modal_data
from labnnum.updating.peers import PEERS, equation_error, output_error, penalty, recursive_filter

from .cases import LINES, measured, truck, truths

STRUCTURE, OUTPUTS, INPUTS, BANDS = truck(3)


@pytest.mark.parametrize("method", [output_error, equation_error, recursive_filter])
def test_exact_data_give_the_exact_parameters(method):
    for theta in truths(STRUCTURE, 2, seed=5):
        frf = measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS, relative=1e-9)
        estimate = method(STRUCTURE, frf, bands=BANDS)
        assert np.allclose(estimate.value, theta, rtol=1e-4)


def test_equation_error_needs_one_step_where_matrices_are_linear():
    theta = truths(STRUCTURE, 1)[0]
    frf = measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS)
    assert np.allclose(equation_error(STRUCTURE, frf, bands=BANDS).value, theta, rtol=1e-9)


def test_poles_come_from_peaks_and_lead_lightly_damped_structures():
    structure = EXAMPLES["kabe-damped"]().structure
    example = EXAMPLES["kabe-damped"]()
    theta = np.array([1080.0, 1.42])
    lines = np.arange(27.0, 39.0, 0.004) / (2 * np.pi)
    frf = measured(structure, theta, lines, example.outputs, example.inputs)
    found = modal_data(frf, example.bands)
    expected, _ = model_modal_data(structure, theta, found)
    n = expected.size // 2
    assert np.allclose(found.values[:n], expected[:n], rtol=2e-4)
    estimate = penalty(structure, frf, bands=example.bands)
    assert estimate["k1"] == pytest.approx(1080.0, rel=0.01)  # k5 hides in close modes, the known weakness of poles


def test_the_filter_weighs_like_least_squares_with_the_prior():
    from labnnum.updating import refine

    theta = truths(STRUCTURE, 1, seed=3)[0]
    frf = measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS, relative=0.05, seed=2)
    filtered = recursive_filter(STRUCTURE, frf, bands=BANDS)
    fitted = refine(STRUCTURE, frf, bands=BANDS, prior=True)
    assert np.allclose(filtered.value, fitted.value, rtol=1e-3)
    assert np.allclose(filtered.std, fitted.std, rtol=0.02)


def test_underdetermined_penalty_changes_little_and_says_so():
    frf = measured(STRUCTURE, truths(STRUCTURE, 1)[0], LINES, OUTPUTS[:1], INPUTS)
    estimate = penalty(STRUCTURE, frf, bands=BANDS[1:2])
    assert any("2 measured poles' values for 5 parameters" in w for w in estimate.warnings)


def test_a_parameter_that_stops_at_its_bound_is_named():
    theta = STRUCTURE.nominal.copy()
    free = STRUCTURE.parameters[1]
    theta[1] = free.upper + 0.05 * (free.upper - free.lower)
    frf = measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS, relative=1e-3)
    estimate = output_error(STRUCTURE, frf, bands=BANDS)
    assert estimate.value[1] == free.upper
    assert any(w.startswith(f"{free.name} ended at its bound") for w in estimate.warnings)


def test_what_is_refused():
    example = EXAMPLES["beam"]()
    lines = np.linspace(10.0, 700.0, 400)
    frf = measured(example.structure, example.structure.nominal, lines, example.outputs, example.inputs)
    with pytest.raises(ChannelError, match="base excitation"):
        equation_error(example.structure, frf, bands=example.bands)
    flat = measured(STRUCTURE, STRUCTURE.nominal, np.linspace(50, 60, 30), OUTPUTS, INPUTS)
    with pytest.raises(EstimationError, match="no band shows a resonance"):
        penalty(STRUCTURE, flat, bands=(type(BANDS[0])(50, 60),))
    assert set(PEERS) == {"penalty", "regularised", "equation-error", "output-error", "filter"}
