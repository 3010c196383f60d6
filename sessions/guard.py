"""Guard: the first to see each block; switches the generator off before anything else happens."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import final

import numpy as np

from drivers.block import Block
from labnnum.errors import SafetyError
from sessions.rig_tables import SafetyTable
from sessions.tables import StoredChannel


@final
class Guard:
    """Watches the limits of each channel, overloads and lost frames.

    Parameters
    ----------
    stored : sequence of StoredChannel
    limits : mapping
        Channel name -> magnitude in SI units at which to warn and at which to stop (None for neither).
    safety : SafetyTable
    off : callable
        Switches the generator off.

    Raises
    ------
    SafetyError
        From the call that sees a limit passed, after the output has been switched off.
    """

    def __init__(
        self,
        stored: Sequence[StoredChannel],
        limits: Mapping[str, tuple[float | None, float | None]],
        safety: SafetyTable,
        off: Callable[[], None],
    ) -> None:
        self._stored, self._safety, self._off = tuple(stored), safety, off
        self._watched = [(i, s, limits[s.channel.name]) for i, s in enumerate(stored) if s.channel.name in limits]
        self.overloaded = np.zeros(len(self._stored), bool)
        self.overloaded_at = np.full(len(self._stored), -1)
        """Frame up to which each channel was last seen overloaded; -1 if never."""
        self.tripped = False
        self.warnings: list[str] = []
        self.gaps = 0
        self._said: set[str] = set()

    def __call__(self, block: Block) -> None:
        """Look at a block."""
        for row, stored, (warn, stop) in self._watched:
            self._limit(stored, float(np.abs(stored.to_si(block.data[row])).max(initial=0.0)), warn, stop)
        if block.overload is not None and block.overload.any():
            self.overloaded_at[block.overload] = block.start + block.n_frames
            self._overload(block.overload)
        if block.lost or block.overflow:
            self.gaps += 1
            what = f"{block.lost} frames were lost" if block.lost else "the input overflowed"
            self._act("lost", self._safety.lost, f"{what} before frame {block.start}; nothing averages across the gap")

    def _limit(self, stored: StoredChannel, peak: float, warn: float | None, stop: float | None) -> None:
        name, unit = stored.channel.name, stored.channel.unit
        if stop is not None and not peak <= stop:  # a sample that is no number keeps no limit
            self._stop(f"channel {name!r} reached {peak:.4g} {unit}, over its stop limit {stop:g} {unit}")
        if warn is not None and not peak <= warn:
            self._warn(
                f"warn {name}", f"channel {name!r} reached {peak:.4g} {unit}, over its warning limit {warn:g} {unit}"
            )

    def _overload(self, overload: np.ndarray) -> None:
        new = overload & ~self.overloaded
        self.overloaded |= overload
        for row in np.flatnonzero(new):
            name = self._stored[row].channel.name
            text = f"channel {name!r} met the end of its range; lower the level or its gain"
            self._act(f"overload {name}", self._safety.overload, text)

    def _act(self, key: str, policy: str, text: str) -> None:
        if policy == "stop":
            self._stop(text)
        if policy == "warn":
            self._warn(key, text)

    def _warn(self, key: str, text: str) -> None:
        if key not in self._said:
            self._said.add(key)
            self.warnings.append(text)

    def _stop(self, text: str) -> None:
        self.tripped = True
        self._off()
        raise SafetyError(f"{text}: the output has been switched off")
