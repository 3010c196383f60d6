"""channel-swap: two channels exchanged, or one inverted."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import final

import numpy as np

from labnnum.mechanisms.base import Mechanism, Place, Site, Term


@final
@dataclass(frozen=True)
class ChannelSwap(Mechanism):
    """Rows a and b exchanged, or row a times -1; nothing continuous to estimate."""

    id = "channel-swap"
    domain = "channel"
    title = "channels exchanged, or one inverted"
    equation = "y_a = x_b, y_b = x_a; or y_a = -x_a"
    shows = "each row matches the other's model"
    told_apart = "nothing else exchanges two rows"
    symbol = "crossed arrows"
    reference = "Dossing (1988), part 1"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each pair of outputs of one quantity, each single channel inverted."""
        nothing = np.zeros((1, 0))
        for a, b in combinations(range(site.n_outputs), 2):
            if site.channels[a].quantity == site.channels[b].quantity:
                place = Place("channel", site.channels[a].name, site.channels[b].name)
                yield Term(self, place, (), nothing, variant="exchanged", data={"swap": (a, b)})
        for i, channel in enumerate(site.channels):
            yield Term(self, Place("channel", channel.name), (), nothing, variant="inverted", data={"invert": i})

    def sense(self, term: Term, p: np.ndarray) -> str | None:
        """Either "exchanged" or "inverted"."""
        return term.variant
