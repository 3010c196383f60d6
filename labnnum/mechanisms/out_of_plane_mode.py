"""out-of-plane-mode: one more mode, with a shape of its own at the sensors (torsion, a cable)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import Mechanism, Place, Site, Term
from labnnum.parameters import Parameter


@final
@dataclass(frozen=True)
class OutOfPlaneMode(Mechanism):
    """y_o += a_o / (s^2 + 2 zeta w s + w^2) times the input, a_o free at each sensor."""

    id = "out-of-plane-mode"
    domain = "modal"
    title = "a mode that the model does not have"
    equation = "y_o += a_o / (s^2 + 2 zeta w s + w^2) f"
    shows = "a peak that the model lacks"
    told_apart = "attached-oscillator leaves a notch at its place and moves the other modes"
    symbol = "twist"
    reference = "Atalla (1996), section 5.6 (torsion excited by the cable)"

    def terms(self, site: Site) -> Iterable[Term]:
        """One added mode anywhere in the band; its shape starts at zero."""
        low, high = site.omega.min() / 2 / np.pi, site.omega.max() / 2 / np.pi
        shape = [Parameter(f"residue_{c.name}", 0.0, -np.inf, np.inf) for c in site.channels[: site.n_outputs]]
        parameters = (
            Parameter("frequency", float(np.sqrt(low * high)), 0.2 * low, 2.0 * high, "Hz"),
            Parameter("damping_ratio", 0.01, 1e-4, 0.1, "1"),
            *shape,
        )
        grid = np.exp(np.arange(np.log(0.3 * low), np.log(1.3 * high), 0.02))
        starts = np.zeros((grid.size, len(parameters)))
        starts[:, 0], starts[:, 1] = grid, 0.01
        yield Term(self, Place("global", "structure"), parameters, starts, data={"extra_mode": True})
