"""Which further sensor or band would tell more, computed from the Fisher information before anything is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.bands import Band, band_mask, check_bands
from labnnum.errors import ModelError
from labnnum.recording import Channel
from labnnum.response import frf_sensitivity, modes
from labnnum.structures.base import Structure
from labnnum.updating.covariance import stable_inverse

_WIDTH = 0.05
"""Half width of a proposed band, as a share of the natural frequency in it."""

_LINES = 40
_REACH = 1.5
"""Highest natural frequency that is proposed, over the highest band's, where nothing else limits it."""

_QUIET = 1e-6
"""Responses below this share of the largest one count as not seen."""


@dataclass(frozen=True, eq=False)
class Suggestion:
    """A further sensor or band and what it would do.

    Parameters
    ----------
    kind : {"sensor", "band"}
    what : str
        "node:direction", or the band in Hz.
    deviation : ndarray, shape (n_parameters,)
        Standard deviations with it, over those without: 0.5 halves one.
    """

    kind: str
    what: str
    deviation: NDArray[np.float64]

    @property
    def gain(self) -> float:
        """Factor by which the parameter that gains most becomes more certain."""
        return float(1 / self.deviation.min())


def suggestions(
    structure: Structure,
    theta: ArrayLike,
    bands: Sequence[Band],
    outputs: Sequence[Channel],
    inputs: Sequence[Channel],
    *,
    relative: float = 0.01,
    highest: float | None = None,
    count: int = 5,
) -> tuple[Suggestion, ...]:
    r"""The sensors and bands that would narrow the parameters most, best first.

    Parameters
    ----------
    theta : array_like, shape (n_parameters,)
        Where to look: the estimate, or nominal values.
    bands, outputs, inputs
        What is measured now; `inputs` stay as they are. A further sensor measures the quantity of the first output.
    relative : float
        Standard deviation of the error of every line, as a share of \|H\|, the same for all channels.
    highest : float, optional
        Hz up to which bands are proposed, such as the last line that the bench measures; by default half as far
        again as the highest band.
    count : int
        Suggestions, at most.

    Notes
    -----
    Ranked by the product over parameters of the standard deviations, whose logarithm is half that of the
    information's determinant (D-optimality). Every band is sampled with the same number of lines.

    References
    ----------
    Atkinson, Donev and Tobias (2007), chapter 10.
    """
    values = np.asarray(theta, float)
    if not structure.parameters:
        raise ModelError("the model has no free parameter: there is nothing to learn about")
    ordered = check_bands(bands)
    measured = {c.dof.lstrip("+-") for c in outputs}
    taken = measured | {c.dof for c in inputs if c.role != "base"}
    sensors = [_moved(outputs[0], d) for d in structure.dofs if d not in taken and _turns(d) == _turns(outputs[0].dof)]
    top = _REACH * max(b.high for b in ordered) if highest is None else highest
    more = _free_bands(structure, values, ordered, top)
    now = _information(structure, values, ordered, outputs, inputs, relative)
    found = [
        _suggested("sensor", c.dof, now, now + _information(structure, values, ordered, [c], inputs, relative))
        for c in sensors
    ]
    found += [
        _suggested("band", f"{b.low:.4g} to {b.high:.4g} Hz", now,
                   now + _information(structure, values, [b], outputs, inputs, relative))
        for b in more
    ]  # fmt: skip
    best = sorted(found, key=lambda s: float(np.log(s.deviation).sum()))
    return tuple(s for s in best if s.gain > 1.01)[:count]


def _turns(dof: str) -> bool:
    """Whether a degree of freedom, "node:direction", is a rotation."""
    return dof.partition(":")[2].lstrip("+-").startswith("r")


def _moved(channel: Channel, dof: str) -> Channel:
    node, _, direction = dof.partition(":")
    return replace(channel, name=dof, node=node, direction=direction)


def _free_bands(structure: Structure, theta: NDArray, bands: Sequence[Band], top: float) -> list[Band]:
    """Bands around natural frequencies up to `top` Hz that none of the bands holds."""
    natural = np.asarray(modes(structure, theta).frequency)
    held = band_mask(bands, natural)
    return [Band(f * (1 - _WIDTH), f * (1 + _WIDTH)) for f in natural[~held] if 0 < f * (1 + _WIDTH) <= top]


def _information(
    structure: Structure, theta: NDArray, bands: Sequence[Band], outputs: Sequence[Channel], inputs: Sequence[Channel],
    relative: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Fisher information in units of the priors' spreads, shape (n_par, n_par)."""
    lines = np.unique(np.concatenate([np.linspace(b.low, b.high, _LINES) for b in bands]))
    lines = lines[lines > 0]
    value, slope = frf_sensitivity(structure, theta, lines, tuple(outputs), tuple(inputs))
    spread = np.array([p.spread for p in structure.parameters])
    size = np.abs(value)
    seen = size > _QUIET * max(float(size.max()), 1e-300)
    share = slope * spread[:, None, None, None] / np.where(seen, relative * value, np.inf)
    flat = share.reshape(len(spread), -1)
    return 2 * np.real(flat @ flat.conj().T)


def _suggested(kind: str, what: str, now: NDArray, then: NDArray) -> Suggestion:
    before, after = (np.sqrt(np.diag(stable_inverse(i)[0])) for i in (now, then))
    return Suggestion(kind, what, after / before)
