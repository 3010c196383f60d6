"""Which runs are fitted and which are held out."""

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear.run import settled
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.runs import CLEARER, kept_back, kept_from_law
from labnnum.frf import Frf
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS


def seen(level, odd, even=0.0):
    """A run that distorts by so many decibels over the noise at the response where it does so most."""
    frf = Frf(np.arange(1.0, 9.0), np.ones((1, 1, 8), complex), OUTPUTS[:1], (FORCE,))
    distortion = {"odd_over_noise": np.array([-1.0, odd]), "even_over_noise": np.array([even, -2.0])}
    return Observation(frf, level, "run", "periodic", distortion)


@pytest.mark.parametrize(
    ("odd", "even", "kept"),
    [
        ((0.0, 0.3), (0.2, 0.0), 1),
        ((25.0, 30.0), (0.0, 0.0), 1),  # both show it
        ((6.0, 39.0), (11.0, 20.0), 0),  # only the last closes the gap: it is fitted
        ((39.0, 6.0), (0.0, 0.0), 1),
        ((0.0, CLEARER - 0.5), (0.0, 0.0), 1),
    ],
)
def test_the_last_of_a_level_is_held_out_unless_it_alone_shows_the_law(odd, even, kept):
    quiet = [seen(1.0, 0.0), seen(1.0, 0.1)]
    loud = [seen(10.0, o, e) for o, e in zip(odd, even, strict=True)]
    assert kept_back([*quiet, *loud]) == {1, 2 + kept}


def test_without_a_repetition_the_last_run_is_held_out():
    assert kept_back([seen(1.0, 0.0), seen(3.0, 0.0), seen(9.0, 40.0)]) == {2}


@pytest.mark.parametrize(
    ("levels", "kept"), [((1.0, 9.0), set()), ((9.0, 1.0, 3.0), {2}), ((1.0, 2.0, 4.0, 8.0), {2}), ((1.0,), set())]
)
def test_the_loudest_of_levels_that_were_not_repeated_is_fitted_to_a_law(levels, kept):
    assert kept_from_law([seen(level, 0.0) for level in levels]) == kept


def test_of_levels_that_were_repeated_one_each_is_held_out_of_a_law():
    assert kept_from_law([seen(level, 0.0) for level in (1.0, 1.0, 9.0, 9.0, 9.0)]) == {1, 4}


def periods(n, error, size=400, seed=2):
    """Spectra (n, 2, size) of one steady state with noise; `error` is added to each period's first channel."""
    rng = np.random.default_rng(seed)
    steady = rng.standard_normal((2, size)) + 1j * rng.standard_normal((2, size))
    noise = 1e-3 * (rng.standard_normal((n, 2, size)) + 1j * rng.standard_normal((n, 2, size)))
    out = steady + noise
    out[:, 0] += np.asarray(error)[:, None]
    return out


@pytest.mark.parametrize(
    ("error", "kept"),
    [
        ([0, 0, 0, 0, 0, 0], (0, 6)),  # noise: all of them
        ([0.3, 0.05, 0, 0, 0, 0], (2, 6)),  # it still moves into its steady state
        ([0, 0, 0, 0.02, 0.1, 0.4], (0, 3)),  # it leaves it
        ([0.5, 0.5, 0.2, 0, 0, 0], (3, 6)),  # it goes from one to another
    ],
)
def test_periods_of_a_run_are_those_of_one_steady_state(error, kept):
    assert settled(periods(6, error)) == slice(*kept)


def test_two_periods_are_both_kept():
    assert settled(periods(2, [0.3, 0])) == slice(0, 2)
