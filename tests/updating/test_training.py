from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from labnnum.errors import EstimationError
from labnnum.parameters import Parameter
from labnnum.updating.training import Disturbance, draw, make_training_set
from labnnum.updating.updater import training_plan

from .cases import LINES, truck


@pytest.fixture(scope="module")
def plan():
    structure, outputs, inputs, bands = truck()
    return training_plan(structure, bands, outputs, inputs, LINES, samples=150, seed=4, noise=0.01)


def test_the_same_bits_whatever_the_block_and_the_workers(plan):
    whole = make_training_set(plan)
    assert whole.is_complete
    assert np.array_equal(whole.features, make_training_set(plan, block=40).features)
    with ThreadPoolExecutor(3) as pool:
        assert np.array_equal(whole.features, make_training_set(plan, block=64, executor=pool).features)


def test_an_interrupted_set_is_finished_to_the_same_bits(plan):
    saved = []
    seen = []
    whole = make_training_set(plan, block=32, save=saved.append, progress=lambda done, n: seen.append((done, n)))
    assert seen[0] == (0, 150)
    assert seen[-1] == (150, 150)
    assert [s.done for s in saved] == [32, 64, 96, 128, 150]
    again = make_training_set(plan, block=64, resume=saved[1])
    assert np.array_equal(again.features, whole.features)


def test_a_set_of_another_plan_is_refused(plan):
    structure, outputs, inputs, bands = truck()
    other = training_plan(structure, bands, outputs, inputs, LINES, samples=150, seed=5)
    with pytest.raises(EstimationError, match="another plan"):
        make_training_set(other, resume=make_training_set(plan))


@pytest.mark.parametrize("sampling", ["sobol", "random", "prior"])
def test_samples_stay_in_range_and_repeat(sampling):
    parameters = (Parameter("a", 1.0, 0.5, 2.0, std=0.3), Parameter("b", 0.1, 0.0, 1.0))
    x = draw(parameters, 200, sampling, 7, 0.05)
    assert np.array_equal(x, draw(parameters, 200, sampling, 7, 0.05))
    assert (x > 0).all() or sampling != "prior"
    reach = 0.0 if sampling == "prior" else 0.0751
    assert (x[:, 0] >= 0.5 - reach).all()
    assert (x[:, 0] <= 2.0 + reach).all()
    assert (x[:, 1] >= 0.0).all()


def test_noise_has_the_size_that_was_asked_for():
    value = np.full((40, 1, 1, 500), 3.0 + 4j)
    noisy = Disturbance(0.02).on(value, seed=1, first=0)
    assert np.sqrt((np.abs(noisy - value) ** 2).mean()) == pytest.approx(0.1, rel=0.02)
    assert np.array_equal(noisy[7:9], Disturbance(0.02).on(value[7:9], seed=1, first=7))
    assert Disturbance().on(value, 1, 0) is value


def test_no_samples_is_refused():
    with pytest.raises(EstimationError, match="0 samples"):
        draw((Parameter("a", 1.0, 0.5, 2.0),), 0, "sobol", 0, 0.0)
