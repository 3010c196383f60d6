"""What a report shows: everything read from one session, nothing computed."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from labnnum.frf import Frf
from sessions.estimates import StoredEstimate, stored_estimates
from sessions.runs import Run
from sessions.store import Result, Session, open_session


@dataclass(frozen=True)
class RunFacts:
    """One run: how long, how it ended, and what went wrong in it."""

    number: int
    label: str
    created: float
    rate: float
    n_samples: int
    level: float
    period: int
    finished: str
    gaps: int
    lost: int
    overflows: int
    overloads: Mapping[str, int]
    hits: tuple[tuple[int, bool, str], ...]
    info: Mapping[str, Any]

    @property
    def duration(self) -> float:
        """In s."""
        return self.n_samples / self.rate


@dataclass(frozen=True)
class ChannelFacts:
    """One channel as the rig describes it."""

    name: str
    quantity: str
    role: str
    place: str
    sensitivity: float | None
    unit: str
    full_scale: float


@dataclass(frozen=True, eq=False)
class Content:
    """A session, ready to be shown.

    Parameters
    ----------
    path : Path
    created : float
        In s since the epoch.
    code_version : str
    runs : tuple of RunFacts
    channels : tuple of ChannelFacts
    frfs : tuple of Frf
        Oldest first, each with "stored" (its path in the session) among its settings.
    estimates : tuple of StoredEstimate
        Oldest first.
    results : tuple of Result
        Every other stored result; further sections look here.
    rig_text, model_text : str
        rig.toml and model.toml as they stood.
    extra : mapping
        What a caller adds for sections of its own.
    """

    path: Path
    created: float
    code_version: str
    runs: tuple[RunFacts, ...] = ()
    channels: tuple[ChannelFacts, ...] = ()
    frfs: tuple[Frf, ...] = ()
    estimates: tuple[StoredEstimate, ...] = ()
    results: tuple[Result, ...] = ()
    rig_text: str = ""
    model_text: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)

    @property
    def estimate(self) -> StoredEstimate | None:
        """The newest estimate; None if there is none."""
        return self.estimates[-1] if self.estimates else None

    @property
    def frf(self) -> Frf | None:
        """The FRF that the newest estimate was made of, else the newest one; None if there is none."""
        if self.estimate is not None:
            for frf in self.frfs:
                if frf.settings.get("stored") == self.estimate.frf:
                    return frf
        return self.frfs[-1] if self.frfs else None


def gather(path: str | os.PathLike[str], extra: Mapping[str, Any] | None = None) -> Content:
    """Everything that the report of a session shows; errors as of `open_session`."""
    with open_session(path) as session:
        estimates = stored_estimates(session)
        return Content(
            path=Path(path),
            created=session.created,
            code_version=session.code_version,
            runs=tuple(_run(run) for run in session.runs),
            channels=_channels(session),
            frfs=tuple(session.frfs()),
            estimates=tuple(estimates),
            results=tuple(r for r in session.results() if r.kind != "estimate"),
            rig_text=session.rig_text,
            model_text=session.model_text,
            extra=extra or {},
        )


def _run(run: Run) -> RunFacts:
    blocks, names = run.blocks, [c.name for c in run.channels]
    return RunFacts(
        number=run.index,
        label=run.label.split(": ", 1)[-1],
        created=run.created,
        rate=run.rate,
        n_samples=run.n_samples,
        level=run.level,
        period=run.period,
        finished=run.finished,
        gaps=len(run.gaps()),
        lost=int(blocks["lost"].sum()) if blocks.size else 0,
        overflows=int(blocks["overflow"].sum()) if blocks.size else 0,
        overloads={name: count for name, count in zip(names, run.overload_counts(), strict=True) if count},
        hits=tuple((hit.index, hit.accepted, hit.reason) for hit in run.hits),
        info=run.info,
    )


def _channels(session: Session) -> tuple[ChannelFacts, ...]:
    """Channels of all runs, each named once, as first seen."""
    seen: dict[str, ChannelFacts] = {}
    for run in session.runs:
        for stored in run.stored:
            c = stored.channel
            place = f"{c.node}:{c.direction}" if c.node or c.direction else ""
            facts = ChannelFacts(c.name, c.quantity, c.role, place, c.sensitivity, c.unit, stored.full_scale)
            seen.setdefault(c.name, facts)
    return tuple(seen.values())
