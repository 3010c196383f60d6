"""Estimates come back from a session as they went in."""

import numpy as np
import pytest

from labnnum.errors import EstimationError
from labnnum.parameters import Estimate, Parameter
from sessions.estimates import StoredEstimate, latest_estimate, store_estimate, stored_estimates
from sessions.store import create_session, open_session

PARAMETERS = (Parameter("m", 10e-3, 7e-3, 13e-3, "kg", 2e-3), Parameter("alpha", 1.5, 0.5, 2.5, "1/s"))


def make(value: float = 10e-3) -> StoredEstimate:
    estimate = Estimate(PARAMETERS, [value, 1.4], [[1e-9, 1e-7], [1e-7, 1e-2]], "network", 1.1, ("look",), False)
    lines = np.array([1.0, 2.5])
    return StoredEstimate(
        estimate,
        frf="results/frf/0001",
        frequency=lines,
        before=np.array([[[1 + 2j, 3j]]]),
        after=np.array([[[4 - 1j, 5]]]),
        bands=((1.0, 2.5),),
        truth={"m": 10.1e-3},
        settings={"updater": "u.h5"},
    )


def test_round_trip(tmp_path):
    with create_session(tmp_path / "s.h5") as session:
        assert store_estimate(session, make()) == "results/estimate/0001"
    with open_session(tmp_path / "s.h5") as session:
        back = latest_estimate(session)
    first = make()
    assert back.estimate.parameters == PARAMETERS
    for key in ("value", "covariance"):
        np.testing.assert_array_equal(getattr(back.estimate, key), getattr(first.estimate, key))
    for key in ("frequency", "before", "after"):
        np.testing.assert_array_equal(getattr(back, key), getattr(first, key))
    assert (back.estimate.method, back.estimate.chi2, back.estimate.warnings) == ("network", 1.1, ("look",))
    assert not back.estimate.converged
    assert (back.frf, back.bands, back.truth) == (first.frf, first.bands, {"m": 10.1e-3})
    assert back.settings == {"updater": "u.h5"}
    assert back.created > 0


def test_none_is_written_over_and_the_last_is_the_latest(tmp_path):
    with create_session(tmp_path / "s.h5") as session:
        store_estimate(session, make(9e-3))
        store_estimate(session, make(11e-3))
        assert [s.estimate["m"] for s in stored_estimates(session)] == [9e-3, 11e-3]
        assert latest_estimate(session).estimate["m"] == 11e-3


def test_a_session_without_one_says_what_to_run(tmp_path):
    with create_session(tmp_path / "s.h5") as session, pytest.raises(EstimationError, match=r"labnnum update s\.h5"):
        latest_estimate(session)
