"""Estimates as a session keeps them: parameters, covariance, and the model's FRF before and after."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import EstimationError
from labnnum.parameters import Estimate, Parameter
from sessions.store import Result, Session

KIND = "estimate"


@dataclass(frozen=True, eq=False)
class StoredEstimate:
    """An estimate beside the measurement that it explains.

    Parameters
    ----------
    estimate : Estimate
    frf : str
        Path of the measured FRF in the session, such as "results/frf/0001".
    frequency : ndarray, shape (n_f,)
        Lines at which the model's FRF is given, in Hz.
    before, after : ndarray, shape (n_out, n_in, n_f)
        FRF of the model at nominal parameters and at the estimate, seen through the window of the measurement.
    bands : tuple of (low, high)
        Frequencies that entered the estimate, in Hz.
    truth : mapping
        Parameter name -> true value; only a simulated bench knows it.
    settings : mapping
        Model fingerprint, updater, method and whatever else made it.
    code_version : str
    created : float
        In s since the epoch.
    """

    estimate: Estimate
    frf: str
    frequency: NDArray[np.float64]
    before: NDArray[np.complex128]
    after: NDArray[np.complex128]
    bands: tuple[tuple[float, float], ...] = ()
    truth: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    code_version: str = ""
    created: float = 0.0

    @property
    def floor(self) -> float:
        """Share of |H| that the model was granted as its own error, beside the random error; chi2 counts it."""
        return float(self.settings.get("floor") or 0.0)


def store_estimate(session: Session, stored: StoredEstimate, name: str = "estimate") -> str:
    """Path of the estimate in the session, beside those that were there already."""
    estimate = stored.estimate
    payload = {
        "parameters": [
            {key: getattr(p, key) for key in ("name", "unit", "nominal", "lower", "upper", "std")}
            for p in estimate.parameters
        ],
        "method": estimate.method,
        "chi2": estimate.chi2,
        "warnings": list(estimate.warnings),
        "converged": estimate.converged,
        "frf": stored.frf,
        "bands": [list(band) for band in stored.bands],
        "truth": dict(stored.truth),
    }
    arrays = {key: getattr(stored, key) for key in ("frequency", "before", "after")}
    arrays |= {"value": estimate.value, "covariance": estimate.covariance}
    return session.add_result(KIND, name, payload, arrays, stored.settings)


def stored_estimates(session: Session) -> list[StoredEstimate]:
    """Every estimate of the session, oldest first."""
    return [_read(result) for result in session.results(KIND)]


def latest_estimate(session: Session) -> StoredEstimate:
    """The newest estimate; EstimationError with the command to run if there is none."""
    found = stored_estimates(session)
    if not found:
        raise EstimationError(f"{session.path}: holds no estimate; make one with 'labnnum update {session.path.name}'")
    return found[-1]


def _read(result: Result) -> StoredEstimate:
    payload, arrays = result.payload, result.arrays
    estimate = Estimate(
        parameters=tuple(Parameter(**p) for p in payload["parameters"]),
        value=arrays["value"],
        covariance=arrays["covariance"],
        method=payload["method"],
        chi2=payload["chi2"],
        warnings=tuple(payload["warnings"]),
        converged=payload["converged"],
    )
    return StoredEstimate(
        estimate=estimate,
        frf=payload["frf"],
        frequency=arrays["frequency"],
        before=arrays["before"],
        after=arrays["after"],
        bands=tuple((low, high) for low, high in payload["bands"]),
        truth=payload["truth"],
        settings=result.settings,
        code_version=result.code_version,
        created=result.created,
    )
