"""Items of a plan: what is measured one after the other, each a run (or several) of the session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from labnnum.errors import ConfigError
from labnnum.excitation import Drive, burst_random, chirp, multisine, periodic_random, random
from labnnum.recording import Channel
from sessions.rig import Rig
from sessions.rig_tables import ExcitationTable
from sessions.runs import Run
from sessions.tables import StoredChannel


@dataclass(frozen=True, eq=False)
class Item:
    """One thing to measure.

    Parameters
    ----------
    key : str
        Names it in the session, so that another day goes on where this one ended.
    number : int
        Place in the plan, from 0.
    stored : tuple of StoredChannel
        Channels, with the point's place filled in.
    point : str
        "node:direction" of a roving plan, or empty.
    level : float
        RMS of the controlled channel in its SI unit; NaN for a hammer.
    realisation : int
    """

    key: str
    number: int
    stored: tuple[StoredChannel, ...]
    point: str = ""
    level: float = float("nan")
    realisation: int = 0

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What is measured."""
        return tuple(s.channel for s in self.stored)

    @property
    def kind(self) -> str:
        """First word of the key."""
        return self.key.split(" ")[0]


def items(rig: Rig) -> tuple[Item, ...]:
    """Everything that the rig's plan asks for, in order.

    Raises
    ------
    ConfigError
        If the plan lacks something: levels for a shaker, a place for a force, a response; or asks for what cannot be:
        a trigger above the force's range.
    """
    if rig.toml.excitation.kind == "none":
        return (Item("record", 0, rig.stored),)
    if not any(c.role == "response" for c in rig.channels):
        raise ConfigError(f"{rig.path}: channel: none has the role response, so there is nothing to measure")
    if rig.toml.excitation.kind == "hammer":
        return _hammer_items(rig)
    return _shaker_items(rig)


def control(rig: Rig) -> Channel:
    """The channel whose level a shaker plan holds: the one named, else the first reference or base."""
    name = rig.toml.excitation.control
    if name:
        return rig.channels[rig.index(name)]
    for channel in rig.channels:
        if channel.role in ("reference", "base"):
            return channel
    raise ConfigError(f"{rig.path}: no channel has the role reference or base, so no level can be held")


def trigger_row(rig: Rig) -> int:
    """Row that the trigger watches: the channel named, else the first force."""
    name = rig.toml.trigger.channel
    if name:
        return rig.index(name)
    for row, channel in enumerate(rig.channels):
        if channel.role == "reference":
            return row
    raise ConfigError(f"{rig.path}: trigger.channel: no channel has the role reference; name the hammer's")


def _hammer_items(rig: Rig) -> tuple[Item, ...]:
    plan, row = rig.toml.plan, trigger_row(rig)
    _require_hammer(rig, row)
    points = plan.points or (_place(rig.channels[row]) if rig.channels[row].dof else "",)
    if not points[0]:
        raise ConfigError(
            f"{rig.path}: plan.points: say where the hammer strikes, or give channel {rig.channels[row].name!r} a node"
        )
    out = []
    for number, point in enumerate(points):
        if plan.rove == "hammer":
            stored = _moved(rig.stored, [row], point)
        else:
            roving = [i for i, c in enumerate(rig.channels) if c.role == "response" and not c.node]
            if not roving:
                raise ConfigError(f'{rig.path}: plan.rove = "sensor" needs a response channel without a node')
            stored = _moved(rig.stored, roving, point)
        out.append(Item(f"hammer {point}", number, stored, point))
    return tuple(out)


def _require_hammer(rig: Rig, row: int) -> None:
    """ConfigError unless the trigger watches the one reference, and can be reached within its range."""
    hammer, level = rig.stored[row], rig.toml.trigger.level
    name, unit = hammer.channel.name, hammer.channel.unit
    others = [c.name for i, c in enumerate(rig.channels) if i != row and c.role in ("reference", "base")]
    if hammer.channel.role != "reference":
        raise ConfigError(
            f"{rig.path}: trigger.channel: {name!r} has the role {hammer.channel.role}; the hammer's own, a reference,"
            " is what triggers"
        )
    if others:
        raise ConfigError(
            f"{rig.path}: channel {others[0]!r}: a hammer plan has one input, {name!r}; give the others the role"
            " monitor or response"
        )
    top = hammer.full_scale * abs(hammer.scale)
    if 0 < top <= level:
        raise ConfigError(
            f"{rig.path}: trigger.level: {level:g} {unit} cannot be reached: the range of {name!r} ends at"
            f" {top:.4g} {unit}"
        )


def _place(channel: Channel) -> str:
    return f"{channel.node}:{channel.direction}"


def _moved(stored: Sequence[StoredChannel], rows: Sequence[int], point: str) -> tuple[StoredChannel, ...]:
    node, _, direction = point.partition(":")
    return tuple(
        replace(s, channel=replace(s.channel, node=node, direction=direction)) if i in rows else s
        for i, s in enumerate(stored)
    )


def _shaker_items(rig: Rig) -> tuple[Item, ...]:
    e = rig.toml.excitation
    if not e.levels:
        raise ConfigError(f"{rig.path}: excitation.levels: give at least one level, RMS in {control(rig).unit}")
    steps = [(level, r) for level in e.levels for r in range(e.realisations)]
    name = e.kind.replace(" ", "-")
    return tuple(
        Item(f"{name} {level:g} #{r + 1}", number, rig.stored, level=level, realisation=r)
        for number, (level, r) in enumerate(steps)
    )


def runs_of(item: Item, runs: Sequence[Run]) -> list[Run]:
    """Runs of a session that belong to `item`."""
    return [r for r in runs if r.info.get("item") == item.key]


def waveform(excitation: ExcitationTable, rate: float, realisation: int) -> Drive:
    """What is played: samples of unit RMS; one period where there is one, else the whole duration and its lead.

    Each realisation has its own seed, `excitation.seed` + realisation; all have the same detection lines.
    """
    e = excitation
    band = (e.low, e.high if e.high is not None else 0.4 * rate)
    seed = e.seed + realisation
    if e.kind == "random":
        return random(rate, round((e.duration + 10 * e.settle + 10) * rate), band, 1.0, seed)
    if e.kind == "burst random":
        bursts = -(-round((e.duration + 10 * e.settle + 10) * rate) // e.period)
        return burst_random(rate, e.period, band, 1.0, seed, burst=e.burst, n_bursts=bursts)
    if e.kind == "periodic random":
        return periodic_random(rate, e.period, band, 1.0, seed)
    if e.kind == "multisine":
        return multisine(rate, e.period, band, 1.0, seed, odd=e.odd, detection=e.detection, grid_seed=e.seed)
    if e.kind == "chirp":
        return chirp(rate, e.period, band, 1.0)
    raise ConfigError(f"excitation.kind {e.kind!r} is not played from samples")
