"""channel-gain: a wrong sensitivity."""

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
class ChannelGain(ChannelMechanism):
    """The channel reads (1 + a) times the truth."""

    id = "channel-gain"
    title = "wrong sensitivity of a channel"
    equation = "y = (1 + a) x"
    shows = "one flat factor on one row"
    told_apart = "on the force channel it is also a factor on all masses and stiffnesses: both are said"
    symbol = "channel flag"
    reference = "Dossing (1988), part 1"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each channel; an input's factor divides every row."""
        sizes = np.array([-0.9, -0.6, -0.3, -0.12, -0.05, 0.05, 0.12, 0.3, 0.7, 1.5])
        for i, channel in enumerate(site.channels):
            parameter = Parameter("gain_error", 0.0, -0.999, 1e3)
            yield Term(self, Place("channel", channel.name), (parameter,), sizes[:, None], data={"channel": i})

    def factor(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """1 + a."""
        return np.full(s.shape, 1 + p[0], complex)

    def factor_derivative(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """1."""
        return np.ones((1, s.size), complex)
