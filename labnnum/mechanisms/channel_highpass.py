"""channel-highpass: an AC-coupled input."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.base import ChannelMechanism, Place, Site, Term
from labnnum.parameters import Parameter


@final
@dataclass(frozen=True)
class ChannelHighpass(ChannelMechanism):
    """First-order high-pass: factor s / (s + 2 pi f_c)."""

    id = "channel-highpass"
    title = "AC coupling of a channel"
    equation = "y = s / (s + 2 pi f_c) x"
    shows = "phase lead of about f_c / f at low frequency, on one row"
    told_apart = "channel-delay: its phase grows with frequency"
    symbol = "channel flag"
    reference = "Horowitz and Hill (2015), section 1.7"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each channel."""
        low = float(site.omega.min()) / 2 / np.pi
        starts = (low * np.array([0.01, 0.03, 0.1, 0.3, 1.0]))[:, None]
        for i, channel in enumerate(site.channels):
            parameter = Parameter("corner", 0.0, 0.0, 20 * low, "Hz")
            yield Term(self, Place("channel", channel.name), (parameter,), starts, data={"channel": i})

    def factor(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """S / (s + 2 pi f_c)."""
        return s / (s + 2 * np.pi * p[0])

    def factor_derivative(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """-2 pi s / (s + 2 pi f_c)^2."""
        return (-2 * np.pi * s / (s + 2 * np.pi * p[0]) ** 2)[None]
