"""The compiled refinement ends where the vectorised one does."""

import numpy as np
import pytest

from labnnum.errors import EstimationError
from labnnum.parameters import truncated_samples
from labnnum.structures.examples import EXAMPLES
from labnnum.updating.batch import FrfBatch
from labnnum.updating.compiled_refine import compiled_refinement
from labnnum.updating.many import refine_many
from labnnum.updating.training import Disturbance


def case(name: str, n_lines: int = 30):
    e = EXAMPLES[name]()
    lines = np.unique(np.concatenate([np.linspace(b.low, b.high, n_lines) for b in e.bands]))
    batch = FrfBatch.of(e.structure, lines, e.outputs, e.inputs)
    free = e.structure.parameters
    theta = truncated_samples(free, np.random.default_rng(0).random((6, len(free))))
    return batch, theta, np.array([p.spread for p in free])


@pytest.mark.parametrize("name", ["truck", "kabe-damped", "yang-brown-low", "beam"])
def test_it_ends_where_the_vectorised_refinement_ends(name):
    batch, theta, spread = case(name)
    value = Disturbance(0.01).on(batch.frf(theta), 0, 0)
    start = theta * (1 + 1e-3 * np.random.default_rng(1).standard_normal(theta.shape))
    expected = refine_many(batch, value, start, tolerance=1e-10)
    refine = compiled_refinement(batch)
    for v, s, t, cost in zip(value, start, expected.value, expected.cost, strict=True):
        found = refine(v, s)
        assert found.converged
        assert np.abs((found.value - t) / spread).max() < 1e-6
        assert found.cost == pytest.approx(cost, rel=1e-4)


def test_it_stays_within_reach_and_says_where_it_did_not_converge():
    batch, theta, _ = case("truck")
    value = batch.frf(theta[:1])[0]
    low, high = (np.array([getattr(p, side) for p in batch.parameters]) for side in ("lower", "upper"))
    found = compiled_refinement(batch, reach=0.0)(value * 1.5, high)
    assert (found.value >= low).all()
    assert (found.value <= high).all()
    assert not compiled_refinement(batch, max_steps=1)(value, low).converged


def test_what_it_cannot_take_is_refused():
    batch, theta, _ = case("truck")
    with pytest.raises(EstimationError, match=r"an FRF of shape \(3, 1, \d+\) is expected, not \(1, 1, 5\)"):
        compiled_refinement(batch)(np.ones((1, 1, 5)), theta[0])
    e = EXAMPLES["frame"]()
    lines = np.linspace(e.bands[0].low, e.bands[0].high, 10)
    with pytest.raises(EstimationError, match="only structures of a few coordinates"):
        compiled_refinement(FrfBatch.of(e.structure, lines, e.outputs, e.inputs))
