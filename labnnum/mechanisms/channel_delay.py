"""channel-delay: a channel that lags the others by a fixed time."""

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
class ChannelDelay(ChannelMechanism):
    """y(t) = x(t - tau): factor exp(-s tau)."""

    id = "channel-delay"
    title = "a channel comes late"
    equation = "y(t) = x(t - tau)"
    shows = "phase of one row linear in frequency"
    told_apart = "channel-highpass: its phase lead dies out with frequency"
    symbol = "channel flag"
    reference = "Oppenheim and Schafer (2010), section 4.6"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each channel, early or late."""
        scale = 1.0 / float(site.omega.max())
        sizes = scale * np.array([0.01, 0.03, 0.1, 0.3, 1.0])
        starts = np.concatenate([sizes, -sizes])[:, None]
        for i, channel in enumerate(site.channels):
            parameter = Parameter("delay", 0.0, -10 * scale, 10 * scale, "s")
            yield Term(self, Place("channel", channel.name), (parameter,), starts, data={"channel": i})

    def factor(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """exp(-s tau)."""
        return np.exp(-s * p[0])

    def factor_derivative(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """-s exp(-s tau)."""
        return (-s * np.exp(-s * p[0]))[None]

    def sense(self, term: Term, p: NDArray) -> str | None:
        """Either "late" or "early"."""
        return "late" if p[0] >= 0 else "early"
