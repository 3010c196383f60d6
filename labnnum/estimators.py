"""Estimates of frequency response functions from spectra: H1, H2, Hv, and period averaging."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError, EstimationError
from labnnum.frf import Frf
from labnnum.hits import Hits
from labnnum.periodic import PeriodicSpectra, RobustFrf, periodic, periodic_spectra, robust
from labnnum.recording import Recording
from labnnum.spectra import Processor, Spectra, Welch

__all__ = [
    "H1", "H2", "Hits", "Hv", "PeriodicSpectra", "RobustFrf", "Spectra", "Welch", "coherence", "h1", "h2", "hv",
    "periodic", "periodic_spectra", "robust",
]  # fmt: skip

NO_INPUT = 1e-24
"""A line whose input density is below this share of the largest carries rounding errors only and is left out."""

DEPENDENT = 1e12
"""Condition number of the scaled input spectra from which inputs count as linearly dependent."""


@final
@dataclass(frozen=True)
class H1:
    """FRFs that are right when the noise is on the responses: H1(Welch(4096))(recording).

    Parameters
    ----------
    processor : Welch or Hits
        What turns recordings into spectra.
    """

    processor: Processor

    def __call__(self, recordings: Recording | Sequence[Recording]) -> Frf:
        """FRFs of all responses to all references and base motions; see `h1`."""
        return h1(self.processor(recordings))


@final
@dataclass(frozen=True)
class H2:
    """FRFs that are right when the noise is on the one input: H2(Welch(4096))(recording)."""

    processor: Processor

    def __call__(self, recordings: Recording | Sequence[Recording]) -> Frf:
        """FRFs of all responses to the one input; see `h2`."""
        return h2(self.processor(recordings))


@final
@dataclass(frozen=True)
class Hv:
    """FRFs by total least squares, noise on inputs and responses alike: Hv(Welch(4096))(recording)."""

    processor: Processor

    def __call__(self, recordings: Recording | Sequence[Recording]) -> Frf:
        """FRFs of all responses to all inputs; see `hv`."""
        return hv(self.processor(recordings))


def h1(spectra: Spectra) -> Frf:
    r"""FRFs by least squares with the noise on the responses, one or several inputs.

    Parameters
    ----------
    spectra : Spectra
        Its channels' roles say which are inputs ("reference", "base") and which responses.

    Returns
    -------
    Frf
        With ordinary (one input) or multiple coherence, variance E|dH|^2, the inputs' spectra and, for several
        inputs, their condition number. Lines without input are left out; settings["dropped_lines"] counts them.
        From no more averages than inputs, coherence and variance are None.

    Raises
    ------
    ChannelError
        There is no input or no response.
    EstimationError
        Fewer segments than inputs, or inputs that are linearly dependent on every line.

    Notes
    -----
    .. math:: H^T = S_{ff}^{-1} S_{fx}, \quad
       \gamma_o^2 = \frac{S_{fx,o}^H S_{ff}^{-1} S_{fx,o}}{S_{xx,o}}, \quad
       E|\delta H_{oi}|^2 = \frac{(1 - \gamma_o^2) S_{xx,o}}{n_d - q} [S_{ff}^{-1}]_{ii}

    with n_d effective averages and q inputs; for one input the last is
    (1 - gamma^2)/(gamma^2 (n_d - 1)) |H|^2.

    References
    ----------
    Bendat and Piersol (2010), Random data, equations 6.86, 7.77 and table 9.6.
    """
    matrices = _matrices(spectra)
    value = np.linalg.solve(matrices.inputs, matrices.cross).transpose(2, 1, 0)
    gamma2 = _multiple_coherence(matrices, value)
    return matrices.frf(value, "H1", gamma2, matrices.variance(gamma2))


def h2(spectra: Spectra) -> Frf:
    r"""FRFs with the noise on the one input.

    Returns
    -------
    Frf
        As from `h1`; its relative random error is that of H1.

    Raises
    ------
    EstimationError
        There are several inputs: take `h1` or `hv`.

    Notes
    -----
    .. math:: H_2 = S_{xx} / S_{xf}

    References
    ----------
    Bendat and Piersol (2010), section 6.1.4.
    """
    if len(spectra.inputs) > 1:
        raise EstimationError("H2 takes one input; with several, use H1 or Hv")
    matrices = _matrices(spectra)
    first = np.linalg.solve(matrices.inputs, matrices.cross).transpose(2, 1, 0)
    gamma2 = _multiple_coherence(matrices, first)
    ratio = 1 / np.where(gamma2 > 0, gamma2, np.inf)
    variance = matrices.variance(gamma2)
    return matrices.frf(
        first * ratio[:, None], "H2", gamma2, None if variance is None else variance * ratio[:, None] ** 2
    )


def hv(spectra: Spectra) -> Frf:
    r"""FRFs by total least squares, each response with all inputs, noise in proportion to each signal's power.

    Returns
    -------
    Frf
        As from `h1`. With one input the magnitude is the geometric mean of H1's and H2's.

    Notes
    -----
    Of the matrix of the inputs and one response, each scaled to unit power, the eigenvector v of the smallest
    eigenvalue is orthogonal to noise-free signals:

    .. math:: H_i = -(v_i / v_x) \sqrt{S_{xx} / S_{ii}}

    The variance is that of the geometric mean with one input,
    |H|^2 (1 - gamma^2)(1 + 1/gamma^2) / (2 (n_d - 1)), and H1's with several.

    References
    ----------
    Rocklin, Crowley and Vold (1985), A comparison of H1, H2 and Hv frequency response functions.
    """
    matrices = _matrices(spectra)
    gamma2 = _multiple_coherence(matrices, np.linalg.solve(matrices.inputs, matrices.cross).transpose(2, 1, 0))
    value = np.stack([_total_least_squares(matrices, o) for o in range(len(matrices.spectra.outputs))])
    variance = matrices.variance(gamma2)
    if variance is not None and value.shape[1] == 1:
        excess = (1 - gamma2) * (1 + 1 / np.maximum(gamma2, 1e-12)) / (2 * matrices.freedom)
        variance = np.abs(value) ** 2 * excess[:, None]
    return matrices.frf(value, "Hv", gamma2, variance)


def _total_least_squares(matrices: _Matrices, output: int) -> NDArray[np.complex128]:
    n_in = matrices.inputs.shape[-1]
    joint = np.empty((matrices.inputs.shape[0], n_in + 1, n_in + 1), complex)
    joint[:, :n_in, :n_in] = matrices.inputs
    joint[:, :n_in, n_in] = matrices.cross[:, :, output]
    joint[:, n_in, :n_in] = matrices.cross[:, :, output].conj()
    joint[:, n_in, n_in] = matrices.power[output]
    size = np.sqrt(np.einsum("fii->fi", joint).real)
    size = np.where(size > 0, size, 1.0)
    smallest = np.linalg.eigh(joint / (size[:, :, None] * size[:, None, :]))[1][:, :, 0]
    last = smallest[:, n_in]
    last = np.where(np.abs(last) > 1e-12, last, 1e-12)
    ratio = -(smallest[:, :n_in] / last[:, None])
    return np.asarray((ratio * size[:, n_in:] / size[:, :n_in]).T, complex)


def coherence(spectra: Spectra, first: str, second: str) -> NDArray[np.float64]:
    """Ordinary coherence of two channels, shape (n_f,); 0 where either has no power.

    Raises
    ------
    EstimationError
        A single average, for which coherence is 1 whatever the data; or a pair that was not averaged.
    """
    if spectra.n_segments < 2:
        raise EstimationError("coherence of a single average is 1 whatever the data: average at least two segments")
    i, j = spectra.index(first), spectra.index(second)
    product = spectra.auto(i) * spectra.auto(j)
    cross = spectra.cross[i, j]
    if np.isnan(cross).any():
        raise EstimationError(f"the cross-spectrum of {first!r} and {second!r} was not averaged: set pairs='all'")
    return np.divide(np.abs(cross) ** 2, product, out=np.zeros(product.size), where=product > 0)


@dataclass(frozen=True, eq=False)
class _Matrices:
    """Input spectra (n_f, q, q), input-response spectra (n_f, q, n_out), response powers (n_out, n_f)."""

    spectra: Spectra
    lines: NDArray[np.intp]
    inputs: NDArray[np.complex128]
    cross: NDArray[np.complex128]
    power: NDArray[np.float64]
    condition: NDArray[np.float64]

    @property
    def freedom(self) -> float:
        """Effective averages beyond the number of inputs."""
        return self.spectra.n_averages - self.inputs.shape[-1]

    def variance(self, gamma2: NDArray) -> NDArray[np.float64] | None:
        if self.freedom <= 1e-9:
            return None
        inverse = np.einsum("fii->if", np.linalg.inv(self.inputs)).real
        noise = (1 - gamma2) * self.power / self.freedom
        return noise[:, None] * inverse[None]

    def frf(self, value: NDArray, name: str, gamma2: NDArray, variance: NDArray | None) -> Frf:
        s = self.spectra
        dropped = s.frequency.size - self.lines.size
        return Frf(
            frequency=s.frequency[self.lines],
            value=value,
            outputs=tuple(s.channels[o] for o in s.outputs),
            inputs=tuple(s.channels[i] for i in s.inputs),
            coherence=None if variance is None else gamma2,
            variance=variance,
            n_averages=s.n_averages,
            estimator=name,
            settings=s.settings | ({"dropped_lines": dropped} if dropped else {}),
            input_spectrum=self.inputs.transpose(1, 2, 0),
            input_condition=self.condition if self.inputs.shape[-1] > 1 else None,
        )


def _matrices(spectra: Spectra) -> _Matrices:
    ins, outs = spectra.inputs, spectra.outputs
    if not ins:
        raise ChannelError("no channel is an input: give one the role 'reference' (a force) or 'base'")
    if not outs:
        raise ChannelError("no channel is a response: give one the role 'response'")
    if spectra.n_segments < len(ins):
        raise EstimationError(
            f"{spectra.n_segments} segments cannot separate {len(ins)} inputs: lower n_segment or record longer"
        )
    inputs = spectra.cross[np.ix_(ins, ins)].transpose(2, 0, 1)
    power = np.einsum("fii->fi", inputs).real
    alive = (power > NO_INPUT * power.max(axis=0)).all(axis=1)
    scale = np.sqrt(np.where(power > 0, power, 1.0))
    scaled = inputs / (scale[:, :, None] * scale[:, None, :])
    condition = np.linalg.cond(scaled) if len(ins) > 1 else np.ones(power.shape[0])
    lines = np.flatnonzero(alive & (condition < DEPENDENT))
    if not lines.size:
        names = ", ".join(repr(spectra.channels[i].name) for i in ins)
        raise EstimationError(
            f"inputs {names} are linearly dependent on every line: drive them with independent signals,"
            " or give all but one the role 'monitor'"
        )
    cross = spectra.cross[np.ix_(ins, outs)].transpose(2, 0, 1)[lines]
    autos = np.stack([spectra.auto(o)[lines] for o in outs])
    return _Matrices(spectra, lines, inputs[lines], cross, autos, condition[lines])


def _multiple_coherence(matrices: _Matrices, value: NDArray) -> NDArray[np.float64]:
    explained = np.einsum("oif,fio->of", value.conj(), matrices.cross).real
    share = np.divide(explained, matrices.power, out=np.zeros(explained.shape), where=matrices.power > 0)
    return np.clip(share, 0.0, 1.0)
