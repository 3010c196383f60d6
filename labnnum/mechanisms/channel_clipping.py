"""channel-clipping: a channel that runs into the end of its range."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.base import Mechanism, Site, Term


@final
@dataclass(frozen=True)
class ChannelClipping(Mechanism):
    """y = min(max(x, -r), r): found in the time signal and on detection lines, not in an FRF."""

    id = "channel-clipping"
    domain = "channel"
    title = "a channel runs into the end of its range"
    equation = "y = clip(x, -r, r)"
    shows = "odd distortion on one channel alone, samples in runs at the rail"
    told_apart = "clearance distorts every channel"
    symbol = "channel flag"
    reference = "Pintelon and Schoukens (2012), section 3.4"

    def terms(self, site: Site) -> Iterable[Term]:
        """None: it is judged before the fit, see `labnnum.diagnosis.gates`."""
        return ()
