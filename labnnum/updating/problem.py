"""One refinement as a problem of least squares: data, model, weights, and the residuals that it may be posed with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labnnum.bands import Band, band_mask, check_bands
from labnnum.errors import EstimationError, ModelError
from labnnum.frf import Frf
from labnnum.parameters import bounds
from labnnum.response import frf_sensitivity
from labnnum.structures.base import Structure
from labnnum.updating.many import LARGEST, first_beyond, on_sphere
from labnnum.updating.noise import Noise, noise_of
from labnnum.updating.seen import View


@dataclass(frozen=True, eq=False)
class Problem:
    """Data, model and scaling of one refinement; x = (theta - nominal) / spread.

    Parameters
    ----------
    structure : Structure
    frf : Frf
        On the lines that count.
    noise : Noise
        Of these lines.
    view : View or None
    mask : ndarray of bool
        Which of the measurement's lines these are.
    spread : ndarray, shape (n_parameters,)
        Prior standard deviations: the natural scale of each parameter.
    prior : ndarray, shape (n_parameters,)
        Information of the priors that count as data, 0 where none does.
    bands : tuple of Band
    floor : float
        Relative error of the model that the weights contain.
    """

    structure: Structure
    frf: Frf
    noise: Noise
    view: View | None
    mask: NDArray[np.bool_]
    spread: NDArray[np.float64]
    prior: NDArray[np.float64]
    bands: tuple[Band, ...]
    floor: float = 0.0

    def theta(self, x: NDArray) -> NDArray[np.float64]:
        """Parameters at x."""
        return self.structure.nominal + x * self.spread

    def x(self, theta: NDArray) -> NDArray[np.float64]:
        """Scaled coordinates of parameters."""
        return (theta - self.structure.nominal) / self.spread

    def model(self, theta: NDArray) -> tuple[NDArray, NDArray]:
        """FRF and slopes on the lines, as the measurement would show them."""
        f = self.frf
        if self.view is None:
            return frf_sensitivity(self.structure, theta, f.frequency, f.outputs, f.inputs)
        value, slope = frf_sensitivity(self.structure, theta, self.view.frequency, f.outputs, f.inputs)
        return self.view.apply(value)[..., self.mask], self.view.apply(slope)[..., self.mask]

    def thinned(self, most: int) -> Problem:
        """Every second, third, ... line, so that at most `most` are kept."""
        n_lines = self.frf.frequency.size
        part = np.arange(0, n_lines, max(1, -(-n_lines // most)))
        n, mask = self.noise, np.zeros_like(self.mask)
        mask[np.flatnonzero(self.mask)[part]] = True
        noise = replace(n, variance=n.variance[..., part], weight=n.weight[..., part], position=n.position[part])
        return replace(self, frf=self.frf.at(part), mask=mask, noise=noise)

    def with_floor(self, floor: float) -> Problem:
        """The same with a relative error of the model added to the weights."""
        if floor == 0.0:
            return replace(self, floor=0.0)
        base = self.noise
        extra = (floor * np.abs(self.frf.value)) ** 2
        noise = replace(base, weight=1 / (1 / base.weight + extra / 2), variance=base.variance + extra)
        return replace(self, noise=noise, floor=floor)

    @property
    def limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper bounds of x."""
        low, high = bounds(self.structure.parameters)
        return self.x(low), self.x(high)

    def complex_residual(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """Difference of the FRFs in units of their random error."""
        value, slope = self.model(self.theta(x))
        root = np.sqrt(self.noise.weight)
        return self._real(root * (value - self.frf.value), root * slope, x)

    def sphere_residual(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """Difference on the Riemann sphere, lines of equal weight: bounded, and smooth as a resonance moves."""
        value, slope = self.model(self.theta(x))
        scale = self._typical
        mine, steep = on_sphere(value[None] / scale, slope[None] / scale)
        theirs, _ = on_sphere(self.frf.value[None] / scale, slope[None, :0])
        steep = steep[0].reshape(len(slope), -1) * self.spread[:, None]
        return (mine - theirs)[0].reshape(-1), steep.T

    @cached_property
    def _typical(self) -> NDArray[np.float64]:
        """Median |H| of each FRF in the band of each line, shape (n_out, n_in, n_f)."""
        size = np.abs(self.frf.value)
        out = np.empty_like(size)
        band = np.searchsorted([b.low for b in self.bands], self.frf.frequency, side="right")
        for number in np.unique(band):
            out[..., band == number] = np.median(size[..., band == number], axis=-1, keepdims=True)
        return np.maximum(out, 1e-300)

    def log_residual(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """Log of the ratio of the FRFs in units of their relative random error."""
        value, slope = self.model(self.theta(x))
        return self._log(value, slope, np.sqrt(self.noise.weight) * np.abs(self.frf.value), x)

    def _log(self, value: NDArray, slope: NDArray, root: NDArray, x: NDArray) -> tuple[NDArray, NDArray]:
        ratio = value / np.where(self.frf.value == 0, 1e-300, self.frf.value)
        size = np.maximum(np.abs(ratio), 1e-300)
        log = np.log(size) + 1j * np.angle(ratio)
        return self._real(root * log, root * slope / np.where(value == 0, 1e-300, value), x)

    def _real(self, r: NDArray, slope: NDArray, x: NDArray) -> tuple[NDArray, NDArray]:
        flat = r.reshape(r.size)
        steep = slope.reshape(len(slope), -1) * self.spread[:, None]
        root = np.sqrt(self.prior) * self.spread
        held = root > 0
        residuals = np.concatenate([np.real(flat), np.imag(flat), (root * x)[held]])
        jacobian = np.concatenate([np.real(steep).T, np.imag(steep).T, np.diag(root)[held]])
        return residuals, jacobian


def make_problem(structure: Structure, frf: Frf, bands: Sequence[Band], view: View | None, prior: bool) -> Problem:
    """The problem on the lines of the bands (all where there is none), checked.

    Raises
    ------
    ModelError
        If the structure has no free parameter.
    EstimationError
        If the FRF is not finite there or too large to be squared, or has fewer data than there are parameters.
    """
    if not structure.parameters:
        raise ModelError("the model has no free parameter: add a [[parameter]] entry to its file")
    mask = band_mask(check_bands(bands, frf.frequency), frf.frequency) if bands else np.ones(frf.frequency.size, bool)
    cut = frf.at(mask)
    row = first_beyond(cut.value)
    if row is not None:
        out, inp, line = row
        which, at = f"{cut.outputs[out].name}/{cut.inputs[inp].name}", f"{cut.frequency[line]:g} Hz"
        if not np.isfinite(cut.value[row]):
            raise EstimationError(f"the FRF {which} is not finite at {at}: leave that line out of the bands")
        raise EstimationError(
            f"the FRF {which} is {abs(cut.value[row]):.3g} at {at}, beyond the {LARGEST:.0e} that can be computed with:"
            " check that channel's unit and sensitivity, or leave the line out of the bands"
        )
    noise = noise_of(frf, mask)
    if 2 * cut.value.size < len(structure.parameters):
        raise EstimationError(
            f"{cut.frequency.size} lines cannot determine {len(structure.parameters)} parameters: widen the bands"
        )
    spread = np.array([p.spread for p in structure.parameters])
    known = np.array([0.0 if p.std is None else 1 / p.std**2 for p in structure.parameters])
    within = check_bands(bands) if bands else (Band(frf.frequency[0], frf.frequency[-1]),)
    return Problem(structure, cut, noise, view, mask, spread, known if prior else 0 * known, within)


def chi_square(difference: NDArray, noise: Noise, n_parameters: int) -> tuple[float, float]:
    """Mean whitened squared residual over its expectation, and the scatter that this ratio has by chance."""
    lines = difference.size
    expected = float((noise.weight * noise.variance).sum()) * max(1 - n_parameters / (2 * lines), 0.5 / lines)
    level = float((noise.weight * np.abs(difference) ** 2).sum()) / expected
    correlated = 1 + 2 * float((np.abs(noise.lags[1:]) ** 2).sum())
    return level, float(np.sqrt(correlated / lines))


def is_misfit(level: float, scatter: float) -> bool:
    """Whether a chi2 of this level cannot be chance."""
    return level > max(1.5, 1 + 5 * scatter)


def memory(difference: NDArray, noise: Noise) -> float:
    """Integrated correlation of the whitened residuals along the lines (1 if they are independent)."""
    r = difference * np.sqrt(noise.weight)
    r = r.reshape(-1, r.shape[-1])
    power = float((np.abs(r) ** 2).sum())
    total = 1.0
    for lag in range(1, r.shape[-1] // 2):
        step = float(np.real((r[:, lag:] * r[:, :-lag].conj()).sum())) / power
        if step < 0.05:
            break
        total += 2 * step
    return total
