"""Faults without a name that are not local laws: a channel that may read anything, a support that moves by itself.

They have no parameters. Their errors are marginalised like the ordinary ones, only far wider, so that a fit costs no
more than that of the base, and are priced by how many they are.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import Mechanism, Place, Site, Term


@final
@dataclass(frozen=True)
class LooseChannel(Mechanism):
    """One channel whose shapes, gain and phase may be anything: it sits elsewhere, resonates, hears a neighbour."""

    id = "loose-channel"
    domain = "channel"
    title = "something without a name on one channel"
    equation = "y_i = any sum of the modes"
    shows = "one row that does not fit, while all others do"
    told_apart = "missing physics of the structure shows in every row"
    symbol = "channel flag with question mark"
    reference = "Allemang (2003)"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each response, and each input where there are several: as a sum of modes, and as nothing of the model's."""
        n_in = len(site.channels) - site.n_outputs
        width = 2 * site.omega.size + 11
        for i, channel in enumerate(site.channels):
            alone = site.n_outputs == 1 if i < site.n_outputs else n_in == 1
            if not alone:
                for kind in ("loose", "dropped"):
                    data = {kind: i, "price": width}
                    yield Term(self, Place("channel", channel.name), (), np.zeros((1, 0)), variant=kind, data=data)


@final
@dataclass(frozen=True)
class LooseSupport(Mechanism):
    """A support that moves by itself while the base moves: a table that rocks or slides askew."""

    id = "loose-support"
    domain = "modal"
    title = "a support that does not move as the base is said to"
    equation = "q_s = (a + b s + c s^2) u_base"
    shows = "rigid motion and modal loads that base motion alone does not give"
    told_apart = "a clamp that gives moves the peaks"
    symbol = "support with question mark"
    reference = "Clough and Penzien (2003), section 26.2"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each held axis of each support under base motion."""
        if site.rigid is None:
            return
        for support, held in site.held.items():
            for k, axis in enumerate(held.axes):
                if held.own_load[k] or np.any(held.load[:, k]):
                    data = {"moved": (support, k), "price": 6}
                    yield Term(self, Place("support", support), (), np.zeros((1, 0)), (), axis, data)
