"""One run of a session: raw blocks as they came, their flags, and every hit with its judgements."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from threading import RLock
from typing import Any, Protocol, final

import numpy as np
from numpy.typing import NDArray

from drivers.block import Block
from labnnum.errors import ChannelError, StoreError
from labnnum.recording import Channel, Recording
from sessions import tables
from sessions.tables import Node, StoredChannel

COMPLETE = "complete"
"""How a run ended that came to its end."""

CUT = "cut off"
"""What is said of the end of a run that did not come to note it."""

_HIT = (("start", "i8"), ("stop", "i8"), ("info", tables.TEXT))
_JUDGEMENT = (
    ("hit", "i4"),
    ("accepted", "u1"),
    ("time", "f8"),
    ("reason", tables.TEXT),
    ("verdicts", tables.TEXT),
)


class Host(Protocol):
    """What a run needs of its session."""

    epoch: int
    """Changes whenever handles of groups and datasets become void."""

    guard: RLock
    """Held while anything is changed: what is read under it is whole."""

    def node(self, path: str) -> Node:
        """A group or dataset."""
        ...

    def transaction(self) -> AbstractContextManager[None]:
        """What happens inside is acknowledged as a whole."""
        ...


@dataclass(frozen=True, slots=True)
class Judgement:
    """Who a hit was accepted or rejected by is its reason; `time` in s since the epoch."""

    accepted: bool
    reason: str
    time: float
    verdicts: tuple[dict[str, Any], ...] = ()


@dataclass(frozen=True, slots=True)
class Hit:
    """One hit: samples [start, stop) of its run, and every judgement passed on it, oldest first."""

    index: int
    start: int
    stop: int
    history: tuple[Judgement, ...]
    info: Mapping[str, Any]

    @property
    def accepted(self) -> bool:
        """The last judgement."""
        return self.history[-1].accepted

    @property
    def reason(self) -> str:
        """Why, in the last judgement's words."""
        return self.history[-1].reason

    @property
    def verdicts(self) -> tuple[dict[str, Any], ...]:
        """Checks with their figures, as last given."""
        return next((j.verdicts for j in reversed(self.history) if j.verdicts), ())


def begin(
    group: Node, channels: Sequence[StoredChannel], rate: float, attributes: Mapping[str, Any], info: Any
) -> None:
    """Lay out a new run in its group."""
    if not rate > 0:
        raise StoreError(f"a run needs a positive sample rate, not {rate:g}")
    if not channels:
        raise ChannelError("a run needs at least one channel")
    group.attrs["rate"] = float(rate)
    group.attrs["created"] = time.time()
    group.attrs["finished"] = ""
    for key, value in attributes.items():
        group.attrs[key] = value
    tables.write_channels(group, "channels", channels)
    tables.write_json(group, "info", info)
    row = [("at", "i8"), ("frames", "i8"), ("start", "i8"), ("time", "f8"), ("lost", "i8"), ("overflow", "u1")]
    tables.new_table(group, "blocks", [*row, ("overload", "u1", (len(channels),))])
    tables.new_table(group, "hits", _HIT, 64)
    tables.new_table(group, "judgements", _JUDGEMENT, 64)


@final
class Run:
    """A run of a session, to read from and, while it is open for writing, to append to.

    What is appended is acknowledged when the call returns: from then on it outlives the process.
    """

    def __init__(self, host: Host, name: str, label: str) -> None:
        self._host, self._name, self.label = host, name, label
        self._epoch, self._nodes = -1, {}
        self.stored = tables.read_channels(self._group, "channels")

    def _node(self, name: str) -> Node:
        """A group or dataset of the run; looked up again after a rolled-back transaction reopened the file."""
        if self._epoch != self._host.epoch:
            self._epoch, self._nodes = self._host.epoch, {}
        if name not in self._nodes:
            self._nodes[name] = self._host.node(f"runs/{self._name}/{name}".rstrip("/"))
        return self._nodes[name]

    @property
    def _group(self) -> Node:
        return self._node("")

    @property
    def index(self) -> int:
        """Number of the run in its session, from 1."""
        return int(str(self._group.name).rsplit("/", 1)[1])

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What was measured."""
        return tuple(c.channel for c in self.stored)

    @property
    def rate(self) -> float:
        """Samples per second."""
        return float(self._group.attrs["rate"])

    @property
    def level(self) -> float:
        """The level asked for; NaN if not stated."""
        return float(self._group.attrs["level"])

    @property
    def period(self) -> int:
        """Samples in a period of the excitation; 0 if not periodic."""
        return int(self._group.attrs["period"])

    @property
    def drop_periods(self) -> int:
        """Transient periods at the start of each contiguous span."""
        return int(self._group.attrs["drop_periods"])

    @property
    def created(self) -> float:
        """When the run began, in s since the epoch."""
        return float(self._group.attrs["created"])

    @property
    def finished(self) -> str:
        """How it ended; "" while it runs or if it was cut off."""
        return str(self._group.attrs["finished"])

    @property
    def info(self) -> dict[str, Any]:
        """What else the bench noted: excitation, generator, point, ..."""
        return tables.read_json(self._group, "info")

    @property
    def unusable(self) -> str:
        """Why no estimate may rest on the run; "" where one may, as on every recording that no plan asked for.

        Of a run of a plan an accepted hit, or the stretch at the level asked for, must be there; with a generator it
        must have come to its end as well.
        """
        item, ended = str(self.info.get("item", "")), self.finished
        if not item or item == "record":
            return ""
        hits = self.hits
        if not any(hit.accepted for hit in hits):
            return f"none of its {len(hits)} hits is accepted" if hits else f"ended before it counted ({ended or CUT})"
        return "" if item.startswith("hammer ") or ended == COMPLETE else f"is not complete ({ended or CUT})"

    @property
    def n_samples(self) -> int:
        """Samples stored per channel."""
        with self._host.guard:
            return self._node("samples").shape[1] if "samples" in self._group else 0

    @property
    def blocks(self) -> NDArray[np.void]:
        """Table of blocks: at, frames, start, time, lost, overflow, overload [n_channels]."""
        with self._host.guard:
            return self._node("blocks")[:]

    @property
    def hits(self) -> tuple[Hit, ...]:
        """Every hit, accepted or not."""
        with self._host.guard:
            hits, judgements = self._node("hits")[:], self._node("judgements")[:]
        history: dict[int, list[Judgement]] = {}
        for row in judgements:
            verdicts = tuple(json.loads(row["verdicts"] or b"[]"))
            judgement = Judgement(bool(row["accepted"]), row["reason"].decode(), float(row["time"]), verdicts)
            history.setdefault(int(row["hit"]), []).append(judgement)
        return tuple(
            Hit(i, int(r["start"]), int(r["stop"]), tuple(history[i]), json.loads(r["info"] or b"{}"))
            for i, r in enumerate(hits)
        )

    def append(self, block: Block) -> int:
        """Store a block with its flags; when this returns, it is acknowledged. Samples stored so far."""
        return self.append_all((block,))

    def append_all(self, blocks: Sequence[Block]) -> int:
        """Store several blocks with one acknowledgement, for devices whose blocks are small. Samples stored so far."""
        for block in blocks:
            if block.data.shape[0] != len(self.stored):
                count = block.data.shape[0]
                raise ChannelError(f"{self.label}: a block of {count} channels in a run of {len(self.stored)}")
        if not blocks:
            return self.n_samples
        with self._host.transaction():
            samples, table = self._samples(blocks[0].data), self._node("blocks")
            at, first = samples.shape[1], table.shape[0]
            rows = []
            for block in blocks:
                overload = np.zeros(len(self.stored), bool) if block.overload is None else block.overload
                flags = (block.start, block.time, block.lost, block.overflow, tuple(overload))
                rows.append((at, block.n_frames, *flags))
                at += block.n_frames
            data = np.concatenate([b.data for b in blocks], axis=1) if len(blocks) > 1 else blocks[0].data
            samples.resize((data.shape[0], at))
            samples[:, at - data.shape[1] :] = data
            table.resize((first + len(blocks),))
            table[first:] = np.array(rows, table.dtype)
        return at

    def add_hit(
        self,
        start: int,
        stop: int,
        accepted: bool = True,
        reason: str = "",
        verdicts: Sequence[Any] = (),
        info: Mapping[str, Any] | None = None,
    ) -> int:
        """Store a hit at stored samples [start, stop) with its first judgement; its number, from 0."""
        if not 0 <= start < stop:
            raise StoreError(f"{self.label}: a hit needs 0 <= start < stop, got {start} and {stop}")
        with self._host.transaction():
            index = tables.append_row(self._node("hits"), (start, stop, _json(info or {})))
            self._judge(index, accepted, reason, verdicts)
        return index

    def judge_hit(self, index: int, accepted: bool, reason: str = "", verdicts: Sequence[Any] = ()) -> None:
        """Accept or reject a hit again; the judgements before are kept."""
        count = self._node("hits").shape[0]
        if not 0 <= index < count:
            raise StoreError(f"{self.label}: there is no hit {index}; there are {count}")
        with self._host.transaction():
            self._judge(index, accepted, reason, verdicts)

    def finish(self, how: str = COMPLETE) -> None:
        """Note that the run ended, and how ("complete", "stopped by the user", "abort: ...")."""
        with self._host.transaction():
            self._group.attrs["finished"] = how

    def read(self, start: int = 0, stop: int | None = None) -> NDArray[np.float64]:
        """Stored samples [start, stop) in SI units, shape (n_channels, n)."""
        raw = self.raw(start, stop)
        if all(c.exact for c in self.stored):
            return raw.astype(float, copy=False)
        return np.array([c.to_si(row) for c, row in zip(self.stored, raw, strict=True)])

    def raw(self, start: int = 0, stop: int | None = None) -> NDArray:
        """Stored samples [start, stop) as they came."""
        stored = self.n_samples
        if not stored:
            return np.zeros((len(self.stored), 0))
        first, last, _ = slice(start, stop).indices(stored)
        return self._node("samples")[:, first : max(first, last)]

    def replay(self) -> Iterator[Block]:
        """The blocks as they came, one by one."""
        for row in self.blocks:
            at, n = int(row["at"]), int(row["frames"])
            flags = (int(row["lost"]), bool(row["overflow"]), row["overload"].astype(bool))
            yield Block(self.raw(at, at + n).astype(float), int(row["start"]), float(row["time"]), *flags)

    def gaps(self) -> tuple[int, ...]:
        """Stored samples that do not continue the sample before: frames were lost, or an overflow stands before."""
        blocks = self.blocks
        if blocks.size < 2:
            return ()
        jump = blocks["start"][1:] != blocks["start"][:-1] + blocks["frames"][:-1]
        broken = jump | (blocks["lost"][1:] > 0) | (blocks["overflow"][1:] > 0) | (blocks["overflow"][:-1] > 0)
        return tuple(int(at) for at in blocks["at"][1:][broken])

    def overload_counts(self) -> tuple[int, ...]:
        """How often each channel reached the end of its range: blocks of a device, stretches of an import."""
        blocks = self.blocks
        own = blocks["overload"].sum(axis=0) if blocks.size else np.zeros(len(self.channels), int)
        noted = [c for c, _, _ in self._notes("overloads")]
        return tuple(int(n) + noted.count(i) for i, n in enumerate(own))

    def bursts(self) -> tuple[int, tuple[int, ...]]:
        """Samples from burst to burst, and the stored samples at which one begins; 0 and none without bursts.

        They are counted from the stretch that the bench kept, which begins with a burst, lost frames included. After
        an overflow, before which frames are missing that nobody counted, no burst's place is known.
        """
        played, hits, blocks = self.info.get("excitation", {}), self.hits, self.blocks
        if played.get("kind") != "burst random" or not hits:
            return 0, ()
        period, first = int(played["period"]), hits[0].start
        begun = max(int(np.searchsorted(blocks["at"], first, side="right")) - 1, 0)
        frame = int(blocks["start"][begun]) + first - int(blocks["at"][begun])
        lost = np.flatnonzero((blocks["overflow"] > 0) & (blocks["at"] > first))
        found: list[int] = []
        for b in blocks[begun : int(lost[0]) if lost.size else None]:
            at, frames = int(b["at"]), int(b["frames"])
            found += range(at + (frame - int(b["start"])) % period, at + frames, period)
        return period, tuple(at for at in found if at >= first)

    def recording(self) -> Recording:
        """All samples in SI units; breaks at gaps and hits; what is no accepted hit, or overflowed, excluded."""
        n, hits, blocks = self.n_samples, self.hits, self.blocks
        starts = [h.start for h in hits if h.accepted]
        overflow = [(int(b["at"]), int(b["at"] + b["frames"])) for b in blocks[blocks["overflow"] > 0]]
        burst, bursts = self.bursts()
        return Recording(
            self.channels,
            self.read(),
            self.rate,
            breaks=(*self.gaps(), *starts, *self._notes("breaks")),
            excluded=(*overflow, *_between(hits, n), *(tuple(e) for e in self._notes("excluded"))),
            overloads=(*_overloads(blocks), *(tuple(o) for o in self._notes("overloads"))),
            period=self.period,
            drop_periods=self.drop_periods,
            level=self.level,
            label=self.label,
            burst=burst,
            bursts=bursts,
        )

    def _notes(self, key: str) -> list:
        """Breaks, exclusions and overloads that an imported recording came with."""
        return self.info.get("imported", {}).get(key, [])

    def _judge(self, index: int, accepted: bool, reason: str, verdicts: Sequence[Any]) -> None:
        row = (index, accepted, time.time(), reason, _json(list(verdicts)))
        tables.append_row(self._node("judgements"), row)

    def _samples(self, data: NDArray) -> Node:
        if "samples" not in self._group:
            n = data.shape[0]
            chunk = int(np.clip(data.shape[1], 256, max(256, 2**22 // n)))
            self._group.create_dataset(
                "samples",
                (n, 0),
                dtype=self._group.attrs["dtype"],
                maxshape=(n, None),
                chunks=(n, chunk),
                fletcher32=True,
            )
        return self._node("samples")


def _json(value: Any) -> str:
    return json.dumps(tables.plain(value), ensure_ascii=False)


def _between(hits: Sequence[Hit], n_samples: int) -> list[tuple[int, int]]:
    """What is no accepted hit; nothing if the run has no hits at all."""
    if not hits:
        return []
    edges = [0]
    for hit in sorted((h for h in hits if h.accepted), key=lambda h: h.start):
        edges += [hit.start, hit.stop]
    edges.append(n_samples)
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if a < b]


def _overloads(blocks: NDArray[np.void]) -> list[tuple[int, int, int]]:
    flagged = blocks[blocks["overload"].any(axis=1)] if blocks.size else blocks
    return [(int(c), int(b["at"]), int(b["at"] + b["frames"])) for b in flagged for c in np.flatnonzero(b["overload"])]
