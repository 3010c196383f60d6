"""Classical updating methods, to compare with: penalty functions, equation error, output error, recursive filter.

They follow Atalla (1996), chapter 2, and so compare the FRF with the model itself: none knows about leakage or about
errors that lines share. `labnnum.updating.refine` does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.bands import Band, band_mask, check_bands
from labnnum.errors import ChannelError, EstimationError
from labnnum.frf import MOTION_ORDER, Frf
from labnnum.parameters import Estimate, bounds
from labnnum.response import frf_sensitivity
from labnnum.structures.base import Structure
from labnnum.updating.covariance import stable_inverse
from labnnum.updating.doubts import at_bounds
from labnnum.updating.lsq import least_squares
from labnnum.updating.modal_data import ModalData, modal_data, model_modal_data
from labnnum.updating.noise import noise_of

_ITERATIONS = 30


def penalty(structure: Structure, frf: Frf, *, bands: Sequence[Band] = ()) -> Estimate:
    r"""Parameters by the weighted penalty function on the poles that the FRF shows.

    Notes
    -----
    With at least as many measured values as parameters
    :math:`\theta_{j+1} = \theta_j + [S^T W S]^{-1} S^T W \delta z`; with fewer, the smallest change of the
    parameters in units of their spread. Measured values z: natural frequency and damping ratio of the largest peak
    of every band.

    References
    ----------
    Atalla (1996), equations 2.27 and 2.30.
    """
    return _by_poles(structure, frf, bands, regularised=False)


def regularised(structure: Structure, frf: Frf, *, bands: Sequence[Band] = ()) -> Estimate:
    """The same with the change from the nominal parameters penalised: Atalla (1996), equation 2.32."""
    return _by_poles(structure, frf, bands, regularised=True)


def _by_poles(structure: Structure, frf: Frf, bands: Sequence[Band], regularised: bool) -> Estimate:
    measured = modal_data(frf, check_bands(bands, frf.frequency))
    spread = _spread(structure)
    low, high = bounds(structure.parameters)
    theta, converged, normal = structure.nominal, False, np.eye(spread.size)
    weight = 1 / measured.scatter
    for _ in range(_ITERATIONS):
        predicted, slope = model_modal_data(structure, theta, measured)
        s, dz = (slope * spread) * weight[:, None], (measured.values - predicted) * weight
        step, normal = _penalty_step(s, dz, (theta - structure.nominal) / spread, regularised)
        new = np.clip(theta + step * spread, low, high)
        converged = bool(np.abs((new - theta) / spread).max() < 1e-8)
        theta = new
        if converged:
            break
    covariance = stable_inverse(normal)[0] * np.outer(spread, spread)
    method = "regularised penalty function" if regularised else "penalty function"
    return _estimate(structure, theta, covariance, method, converged, _few(measured, spread.size))


def _penalty_step(s: NDArray, dz: NDArray, gone: NDArray, regularised: bool) -> tuple[NDArray, NDArray]:
    n_values, n = s.shape
    if regularised:
        normal = s.T @ s + np.eye(n)
        return np.linalg.solve(normal, s.T @ dz - gone), normal
    if n_values >= n:
        return np.linalg.lstsq(s, dz, rcond=1e-12)[0], s.T @ s
    return s.T @ np.linalg.lstsq(s @ s.T, dz, rcond=1e-12)[0], s.T @ s + np.eye(n)


def _few(measured: ModalData, n: int) -> tuple[str, ...]:
    if measured.values.size >= n:
        return ()
    return (f"{measured.values.size} measured poles' values for {n} parameters: the smallest change was chosen",)


def output_error(structure: Structure, frf: Frf, *, bands: Sequence[Band] = ()) -> Estimate:
    """Parameters that minimise the unweighted output error, with exact sensitivities.

    References
    ----------
    Atalla (1996), equations 2.44 and 2.45.
    """
    cut = _cut(frf, bands)
    spread = _spread(structure)
    size = float(np.sqrt((np.abs(cut.value) ** 2).mean()))

    def residual(x: NDArray) -> tuple[NDArray, NDArray]:
        value, slope = _model(structure, structure.nominal + x * spread, cut)
        r = ((value - cut.value) / size).reshape(-1)
        steep = slope.reshape(len(slope), -1) * (spread[:, None] / size)
        return np.concatenate([np.real(r), np.imag(r)]), np.concatenate([np.real(steep).T, np.imag(steep).T])

    low, high = ((b - structure.nominal) / spread for b in bounds(structure.parameters))
    found = least_squares(residual, np.zeros(spread.size), low, high)
    r, jacobian = residual(found.x)
    power = float(r @ r) / max(r.size - spread.size, 1)
    covariance = power * stable_inverse(jacobian.T @ jacobian)[0] * np.outer(spread, spread)
    return _estimate(structure, structure.nominal + found.x * spread, covariance, "output error", found.converged)


def equation_error(structure: Structure, frf: Frf, *, bands: Sequence[Band] = ()) -> Estimate:
    r"""Parameters that minimise the equation error B(theta) x - f, coordinates that were not measured expanded.

    Raises
    ------
    ChannelError
        If the structure is driven through its base: equation error needs forces.

    Notes
    -----
    :math:`A\,\delta\theta = b` with A = [B_1 x, ... B_p x] and b = f - B x. The responses of coordinates that no
    channel measures come from the current model, :math:`x_s = B_{ss}^{-1}(f_s - B_{sm} x_m)`. Noise on the
    measured responses biases this method.

    References
    ----------
    Atalla (1996), equations 2.34 to 2.40.
    """
    cut = _cut(frf, bands)
    if any(c.role == "base" for c in cut.inputs):
        raise ChannelError("equation error needs a force input; this measurement has base excitation")
    spread = _spread(structure)
    low, high = bounds(structure.parameters)
    theta, converged, normal, power = structure.nominal, False, np.eye(spread.size), 1.0
    receptance = (
        cut.value / (1j * cut.omega) ** np.array([MOTION_ORDER[c.quantity] for c in cut.outputs])[:, None, None]
    )
    for _ in range(_ITERATIONS):
        a, b = _equation_rows(structure, theta, cut, receptance)
        a = a * spread
        step = np.linalg.lstsq(a, b, rcond=1e-12)[0]
        normal, power = a.T @ a, float(((b - a @ step) ** 2).sum()) / max(b.size - step.size, 1)
        new = np.clip(theta + step * spread, low, high)
        converged = bool(np.abs((new - theta) / spread).max() < 1e-8)
        theta = new
        if converged:
            break
    covariance = power * stable_inverse(normal)[0] * np.outer(spread, spread)
    return _estimate(structure, theta, covariance, "equation error", converged)


def _equation_rows(
    structure: Structure, theta: NDArray, cut: Frf, receptance: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Real rows of equation 2.38, each scaled by the model's stiffness."""
    m = structure.matrices(theta)
    b = m.dynamic_stiffness(cut.omega)
    rows = np.array([c.sign * structure.participation(c.dof, theta) for c in cut.outputs])
    loads = np.array([c.sign * structure.participation(c.dof, theta) for c in cut.inputs]).T
    free = np.linalg.svd(rows)[2][len(rows) :].T
    held = np.linalg.pinv(rows)
    known = np.moveaxis(receptance, -1, 0)
    at = held @ known
    inner = free.T @ b @ free
    x = at + (free @ np.linalg.solve(inner, free.T @ (loads - b @ at)) if free.shape[1] else 0.0)
    size = np.sqrt(np.abs(np.einsum("fii->fi", b)) ** 2).mean(axis=0)[None, :, None]
    error = (loads - b @ x) / size
    columns = [(d.dynamic_stiffness(cut.omega) @ x) / size for d in structure.derivatives(theta)]
    flat = np.array([c.reshape(-1) for c in columns]).T
    right = error.reshape(-1)
    return np.concatenate([np.real(flat), np.imag(flat)]), np.concatenate([np.real(right), np.imag(right)])


def recursive_filter(structure: Structure, frf: Frf, *, bands: Sequence[Band] = (), passes: int = 20) -> Estimate:
    r"""Parameters by an extended Kalman filter that takes in one line after the other.

    Parameters
    ----------
    passes : int
        Times, at most, that all lines are taken in: each time linearised about the estimate before, with the prior
        covariance restored.

    Notes
    -----
    Parameters start at their nominal values with their priors' covariance P;
    :math:`K = P S^T (S P S^T + R)^{-1}`, :math:`\theta \leftarrow \theta + K(z - h(\theta_0) - S(\theta -
    \theta_0))`, :math:`P \leftarrow (1 - K S) P`.

    References
    ----------
    Atalla (1996), section "Frequency domain filters"; Simonian (1981).
    """
    cut = _cut(frf, bands)
    variance = noise_of(cut).variance
    spread = _spread(structure)
    low, high = bounds(structure.parameters)
    theta, covariance, converged = structure.nominal, np.diag(spread**2), False
    for _ in range(passes):
        new, covariance = _one_pass(structure, theta, cut, variance, spread)
        new = np.clip(new, low, high)
        converged = bool(np.abs((new - theta) / spread).max() < 1e-3)
        theta = new
        if converged:
            break
    return _estimate(structure, theta, covariance, "recursive filter", converged)


def _one_pass(
    structure: Structure, centre: NDArray, cut: Frf, variance: NDArray, spread: NDArray
) -> tuple[NDArray, NDArray]:
    value, slope = _model(structure, centre, cut)
    x, p = (structure.nominal - centre) / spread, np.eye(spread.size)
    for line in range(cut.frequency.size):
        s = (slope[..., line].reshape(len(slope), -1) * spread[:, None]).T
        s = np.concatenate([np.real(s), np.imag(s)])
        gap = (cut.value[..., line] - value[..., line]).reshape(-1)
        gap = np.concatenate([np.real(gap), np.imag(gap)]) - s @ x
        r = np.tile(variance[..., line].reshape(-1) / 2, 2)
        gain = np.linalg.solve(s @ p @ s.T + np.diag(r), s @ p).T
        x, p = x + gain @ gap, p - gain @ s @ p
        p = (p + p.T) / 2
    return centre + x * spread, p * np.outer(spread, spread)


def _cut(frf: Frf, bands: Sequence[Band]) -> Frf:
    cut = frf.at(band_mask(check_bands(bands, frf.frequency), frf.frequency)) if bands else frf
    if cut.frequency[0] == 0:
        cut = cut.at(cut.frequency > 0)
    if not np.isfinite(cut.value).all():
        raise EstimationError("the FRF is not finite on every line of the bands: leave such lines out")
    return cut


def _model(structure: Structure, theta: NDArray, cut: Frf) -> tuple[NDArray, NDArray]:
    return frf_sensitivity(structure, theta, cut.frequency, cut.outputs, cut.inputs)


def _spread(structure: Structure) -> NDArray[np.float64]:
    return np.array([p.spread for p in structure.parameters])


def _estimate(
    structure: Structure, theta: NDArray, covariance: NDArray, method: str, converged: bool,
    warnings: tuple[str, ...] = (),
) -> Estimate:  # fmt: skip
    late = () if converged else (f"{method} did not converge from the nominal parameters",)
    warnings = (*warnings, *late, *at_bounds(structure.parameters, theta))
    return Estimate(structure.parameters, theta, covariance, method, converged=converged, warnings=warnings)


PEERS: dict[str, Callable[..., Estimate]] = {
    "penalty": penalty,
    "regularised": regularised,
    "equation-error": equation_error,
    "output-error": output_error,
    "filter": recursive_filter,
}
"""Classical methods by the name that `labnnum update --method` takes."""
