"""recording-filter: the low-pass of a recorder, the same on every channel."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.base import ChannelMechanism, Place, Site, Term
from labnnum.parameters import Parameter

SECTIONS = 4
"""Sections of second order at most: an anti-alias filter of eighth order."""
EVERY = "all"
"""Name of the place: no one channel, but all of them."""


@final
@dataclass(frozen=True)
class RecordingFilter(ChannelMechanism):
    """A low-pass of one to four sections of second order, 1 / (1 + a s + b s^2) each, on all channels alike."""

    id = "recording-filter"
    title = "low-pass of the recorder, common to all channels"
    equation = "y = prod_i 1 / (1 + a_i s + b_i s^2) x on every channel"
    shows = "nothing in any FRF; harmonics above the excited band are smaller and later than a law makes them"
    told_apart = "channel-delay, channel-gain: they stand on one row of the FRFs"
    symbol = "recorder flag"
    reference = "Pintelon and Schoukens (2012), section 1.5"
    common = True

    def terms(self, site: Site) -> Iterable[Term]:
        """None: it cancels in every FRF; see `labnnum.diagnosis.nonlinear.recorder`."""
        return ()

    def term(self, n: int = SECTIONS, half_power_std: float = 0.0) -> Term:
        """The filter of `n` sections; the standard deviation of where it is 3 dB down, in Hz, if it was fitted."""
        names = [(f"{k}{i}", unit) for i in range(1, n + 1) for k, unit in (("a", "s"), ("b", "s^2"))]
        parameters = tuple(Parameter(name, 0.0, 0.0, np.inf, unit) for name, unit in names)
        data = {"channels": EVERY, "half_power_std": half_power_std}
        return Term(self, Place("channel", EVERY), parameters, np.zeros((0, len(names))), data=data)

    def factor(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """Product of 1 / (1 + a s + b s^2); `p` holds a1, b1, a2, b2 ..."""
        out = np.ones(np.shape(s), complex)
        for a, b in np.reshape(p, (-1, 2)):
            out = out / (1 + a * s + b * s * s)
        return out

    def factor_derivative(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """-s F / (1 + a s + b s^2) and s times that, section by section."""
        whole = self.factor(s, p)
        rows = []
        for a, b in np.reshape(p, (-1, 2)):
            one = -s * whole / (1 + a * s + b * s * s)
            rows += [one, s * one]
        return np.array(rows)

    def derived(self, term: Term, p: NDArray, std: NDArray) -> dict[str, tuple[float, float, str]]:
        """Corner frequency 1 / (2 pi sqrt(b)) of each section, and where the whole filter is 3 dB down.

        Sections trade with each other, so that the latter's standard deviation does not follow from theirs: the fit
        leaves it in the term.
        """
        out: dict[str, tuple[float, float, str]] = {}
        for i, (b, s) in enumerate(zip(p[1::2], std[1::2], strict=True), 1):
            if b > 0:
                corner = 1 / (2 * np.pi * np.sqrt(b))
                out[f"corner{i}"] = (float(corner), float(corner * s / (2 * b)), "Hz")
        down = self.half_power(p)
        if np.isfinite(down):
            out["half_power"] = (down, float(term.data.get("half_power_std", 0.0)), "Hz")
        return out

    def half_power(self, p: NDArray) -> float:
        """Lowest frequency in Hz at which |F|^2 is a half; infinite where it is nowhere."""
        top = max([0.0, *(a for a in p[0::2]), *(np.sqrt(b) for b in p[1::2])])
        if top == 0.0:
            return np.inf
        f = np.linspace(0.0, 10 / (2 * np.pi * top), 4001)
        size = np.abs(self.factor(2j * np.pi * f, p)) ** 2
        below = np.flatnonzero(size < 0.5)
        if not below.size:
            return np.inf
        at = int(below[0])
        return float(np.interp(-0.5, -size[at - 1 : at + 1], f[at - 1 : at + 1]))
