import numpy as np
import pytest

from labnnum.errors import EstimationError
from labnnum.structures.examples import EXAMPLES
from labnnum.updating import refine
from labnnum.updating.batch import FrfBatch
from labnnum.updating.many import bound_deviations, on_sphere, refine_many

from .cases import measured, truths


@pytest.fixture(scope="module", params=["truck", "kabe-damped"])
def case(request):
    example = EXAMPLES[request.param]()
    f = np.unique(np.concatenate([np.linspace(b.low, b.high, 40) for b in example.bands]))
    outputs = example.outputs[:1] if request.param == "truck" else example.outputs
    return example, FrfBatch.of(example.structure, f, outputs, example.inputs)


def noisy(value, relative, seed=0):
    rng = np.random.default_rng(seed)
    return value * (
        1 + relative / np.sqrt(2) * (rng.standard_normal(value.shape) + 1j * rng.standard_normal(value.shape))
    )


def test_exact_frfs_give_exact_parameters_from_nominal(case):
    example, batch = case
    theta = truths(example.structure, 12)
    start = np.repeat(example.structure.nominal[None], 12, axis=0)
    found = refine_many(batch, batch.frf(theta), start, approach=True)
    assert found.converged.all()
    assert np.allclose(found.value, theta, rtol=1e-8)


def test_errors_reach_the_bound(case):
    example, batch = case
    theta = truths(example.structure, 200, seed=1)
    found = refine_many(batch, noisy(batch.frf(theta), 0.01), theta, reach=5.0)
    standardised = (found.value - theta) / bound_deviations(batch, theta, 0.01)
    assert np.allclose((standardised**2).mean(axis=0), 1.0, atol=0.4)


def test_it_finds_what_the_careful_way_finds(case):
    example, batch = case
    theta = truths(example.structure, 2, seed=4)
    value = noisy(batch.frf(theta), 0.01)
    scatter = 0.01 * np.abs(batch.frf(theta))
    found = refine_many(batch, value, theta, scatter=scatter, reach=0.0)
    for mine, h, sd in zip(found.value, value, scatter, strict=True):
        frf = measured(example.structure, example.structure.nominal, batch.frequency, batch.outputs, batch.inputs)
        frf = type(frf)(frf.frequency, h, frf.outputs, frf.inputs, variance=sd**2)
        estimate = refine(example.structure, frf, example.structure.nominal)
        assert np.allclose(mine, estimate.value, rtol=1e-6)


def test_memory_does_not_change_the_answer(case, monkeypatch):
    example, batch = case
    theta = truths(example.structure, 10, seed=2)
    value = noisy(batch.frf(theta), 0.02)
    whole = refine_many(batch, value, theta)
    monkeypatch.setattr("labnnum.updating.many._BYTES", 1)
    assert np.allclose(refine_many(batch, value, theta).value, whole.value, rtol=1e-7)


def test_the_sphere_has_exact_slopes():
    rng = np.random.default_rng(0)
    h = rng.standard_normal((3, 5)) + 1j * rng.standard_normal((3, 5))
    direction = rng.standard_normal((3, 1, 5)) + 1j * rng.standard_normal((3, 1, 5))
    point, slope = on_sphere(h, direction)
    assert np.allclose((point**2).sum(axis=-1), 1.0)
    up, _ = on_sphere(h + 1e-6 * direction[:, 0], direction)
    down, _ = on_sphere(h - 1e-6 * direction[:, 0], direction)
    assert np.allclose(slope[:, 0], (up - down) / 2e-6, atol=1e-8)


def test_far_starts_are_tried_where_nominal_leads_nowhere():
    example = EXAMPLES["kabe-damped"]()
    f = np.unique(np.concatenate([np.linspace(b.low, b.high, 60) for b in example.bands]))
    for i, theta in enumerate(truths(example.structure, 5, seed=8)):
        frf = measured(example.structure, theta, f, example.outputs, example.inputs, relative=0.01, seed=i)
        estimate = refine(example.structure, frf, bands=example.bands)
        assert np.abs((estimate.value - theta) / estimate.std).max() < 5
        assert estimate.chi2 < 1.5


@pytest.mark.parametrize("size", [1e90, 1e200, np.nan, np.inf])
def test_an_frf_too_large_to_square_is_named(case, size):
    example, batch = case
    start = np.repeat(example.structure.nominal[None], 3, axis=0)
    value = batch.frf(start)
    value[1, -1, 0, 7] = size
    where = f"FRF 1 of 3, output {len(batch.outputs) - 1}, input 0, is {size:.3g} at line 7"
    for approach in (False, True):
        with pytest.raises(EstimationError, match=where.replace("+", r"\+")):
            refine_many(batch, value, start, approach=approach)


def test_an_frf_as_large_as_can_be_is_fitted():
    example = EXAMPLES["truck"]()
    f = np.linspace(1.0, 6.9, 60)
    batch = FrfBatch.of(example.structure, f, example.outputs[:1], example.inputs)
    value = 1e60 * batch.frf(example.structure.nominal[None])
    assert np.isfinite(refine_many(batch, value, example.structure.nominal[None], approach=True).value).all()
