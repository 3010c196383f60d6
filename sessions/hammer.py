"""Hammer: hits of one point, each judged with its reason, until enough are accepted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from drivers.trigger import Event, Trigger
from labnnum.clipping import noise_level
from labnnum.errors import DriverError
from labnnum.estimators import H1, Hits
from labnnum.hammer import (
    HitSettings,
    best_hits,
    consistency_verdicts,
    find_pulse,
    hit_transforms,
    hit_verdicts,
)
from labnnum.hits import gate
from labnnum.recording import Recording
from labnnum.verdict import Verdict
from sessions.desk import Desk, shown
from sessions.items import trigger_row
from sessions.runs import Run
from sessions.snapshot import Curves, HitLine, curves, failed_checks

REACHED = 1e-2
"""Power of the force over its largest from which a line counts as excited."""

HEARD = 20.0
"""Power of a response over that of its noise from which a line tells whether hits agree."""

QUIET = 30.0
"""s without a hit after which the person is told what the trigger has seen."""

FEW = 8
"""Lines that are needed to tell."""


@final
class HammerRun:
    """Measures one point of a hammer plan on a desk.

    Parameters
    ----------
    desk : Desk
    earlier : sequence of Run
        Runs of the same point from before an interruption; their hits count.
    """

    def __init__(self, desk: Desk, earlier: Sequence[Run] = ()) -> None:
        self.desk = desk
        rig, t = desk.rig, desk.rig.toml.trigger
        self._row = trigger_row(rig)
        pre, length = round(t.pre * rig.rate), round((t.pre + t.duration) * rig.rate)
        self.trigger = Trigger(t.level, pre, length, t.hysteresis, t.slope)
        desk.tail.keep(length)
        self._plan, self._quality = rig.toml.plan, rig.toml.quality
        self._lines: list[HitLine] = []
        self._signals: list[NDArray[np.float64]] = []
        self._places: list[tuple[Run, int]] = []
        self._undo: list[tuple[int, bool]] = []
        self.enough = self._doubted = False
        for run in earlier:
            self._recall(run)
        self._recalled = len(self._lines)

    @property
    def accepted(self) -> list[int]:
        """Numbers of the hits that count."""
        return [i for i, line in enumerate(self._lines) if line.accepted]

    @property
    def complete(self) -> bool:
        """Whether enough hits are accepted, before the best of them are chosen."""
        return len(self.accepted) >= self._plan.hits

    def measure(self) -> None:
        """Take hits until enough are accepted, and in an attended plan until the person says "next"."""
        try:
            self._measure()
        except DriverError:
            self._obey()  # what was said of a hit before the end holds
            raise

    def _measure(self) -> None:
        desk, detector = self.desk, self.trigger.start()
        missed, largest = 0, 0.0
        self._show()
        for one, si in desk.blocks():
            if one.skipped:
                detector.jump(one.at)
                desk.say(f"the display fell behind; {one.skipped} samples were not searched for hits")
            elif one.broken:
                detector.gap()
            for event in detector.feed(si[self._row]):
                self._take(event)
            for miss in detector.missed[missed:]:
                desk.say(f"a hit at {miss.at / desk.rig.rate:.2f} s was not taken: {miss.reason}")
            missed = len(detector.missed)
            largest = max(largest, float(np.abs(si[self._row]).max(initial=0.0)))
            if desk.position > QUIET * desk.rig.rate and not self._lines and not self._doubted and not detector.busy:
                self._doubt(largest)
            self._say_what_to_do(detector.busy)
            if self._obey() or (self.complete and self._plan.auto):
                break
            taken = len(self._lines) - self._recalled
            if taken >= self._plan.most:
                before = f", {self._recalled} before" if self._recalled else ""
                desk.say(f"{taken} hits{before}, and only {len(self.accepted)} accepted; giving up this point")
                break
        self.enough = self.complete
        self._choose()
        self._show()

    def _doubt(self, largest: float) -> None:
        """Nobody struck, or nothing was heard of it: the person can tell which."""
        channel, self._doubted = self.desk.item.channels[self._row], True
        self.desk.say(
            f"no hit within {QUIET:g} s: {channel.name!r} reached {largest:.3g} {channel.unit}, trigger.level is"
            f" {self.trigger.level:g}"
        )

    def _take(self, event: Event) -> None:
        signal = self.desk.tail.cut(event.start, event.stop)
        verdicts = self._judge(signal)
        bad = [v for v in verdicts if not v.ok]
        reason = "; ".join(v.reason for v in bad) or "all checks passed"
        peak = float(np.abs(signal[self._row]).max())
        index = self.desk.run.add_hit(
            event.start, event.stop, not bad, reason, verdicts, {"trigger": event.at, "peak": peak}
        )
        self._places.append((self.desk.run, index))
        self._signals.append(signal)
        self._lines.append(HitLine(len(self._lines), not bad, reason, peak, failed_checks(bad)))
        self._undo.append((len(self._lines) - 1, False))
        self._show(signal)

    @property
    def _order(self) -> list[int]:
        """Rows with the force first, then the responses."""
        return [self._row, *(i for i, c in enumerate(self.desk.item.channels) if c.role == "response")]

    def _judge(self, signal: NDArray) -> list[Verdict]:
        rig, order = self.desk.rig, self._order
        names = [rig.channels[i].name for i in order]
        verdicts = hit_verdicts(signal[order[0]], signal[order[1:]], rig.rate, self._rules(), names)
        others = [self._signals[i] for i in self.accepted if self._signals[i].shape == signal.shape]
        if all(verdicts) and len(others) >= 2:
            verdicts += self._consistency([*others, signal], names[1:])
        return verdicts

    def _rules(self) -> HitSettings:
        q, p = self._quality, self.desk.rig.toml.processing
        scale = {s.channel.name: s.full_scale * abs(s.scale) for s in self.desk.item.stored if s.full_scale > 0}
        return HitSettings(
            second_hit=q.second_hit,
            force_range=q.force_range or (0.0, float("inf")),
            reach=q.reach,
            reach_drop=q.reach_drop,
            settled=q.settled,
            decay=p.decay,
            full_scale=scale,
        )

    def _transforms(self, signals: Sequence[NDArray]) -> NDArray[np.complex128]:
        """Of the lines in the excitation's band that the force reaches, shape (n_hits, 1 + n_out, n_lines)."""
        spectra = hit_transforms([self._gated(s[self._order]) for s in signals])
        low, high = self._band(spectra.shape[-1])
        spectra = spectra[..., low:high]
        force = np.mean(np.abs(spectra[:, 0]) ** 2, axis=0)
        return spectra[..., force >= REACHED * force.max()]

    def _gated(self, signal: NDArray) -> NDArray[np.float64]:
        """The hit, force first, with what lies far from the pulse taken for noise and left out of the force."""
        rate, out = self.desk.rig.rate, np.array(signal)
        width = 2 * find_pulse(out[0]).length / rate
        out[0] *= gate(out[0] - np.median(out[0]), rate, width, 2 * width)
        return out

    def _consistency(self, signals: Sequence[NDArray], names: Sequence[str]) -> list[Verdict]:
        """Whether the last of `signals` agrees with the others, on the lines where a channel hears more than noise."""
        spectra = self._transforms(signals)
        out = []
        for k, (row, name) in enumerate(zip(self._order[1:], names, strict=True), start=1):
            floor = np.mean([noise_level(s[row]) ** 2 for s in signals]) * signals[0].shape[1]
            heard = np.mean(np.abs(spectra[:, k]) ** 2, axis=0) >= HEARD * floor
            if np.count_nonzero(heard) >= FEW:
                pair = spectra[:, [0, k]][..., heard]
                out += consistency_verdicts(pair, self._quality.consistency, [name])[-1]
        return out

    def _obey(self) -> bool:
        """Carry out what the person asked for; True at "next"."""
        commands, self.desk.commands = self.desk.commands, []
        for command in commands:
            word, _, number = command.partition(" ")
            if word == "next":
                return True
            if word in ("accept", "reject") and self._lines:
                index = int(number) if number else len(self._lines) - 1
                self._set(index, word == "accept", f"{word}ed by the user")
            elif word == "undo" and self._undo:
                index, before = self._undo.pop()
                self._set(index, before, "undone by the user", remember=False)
        return False

    def _set(self, index: int, accepted: bool, reason: str, remember: bool = True) -> None:
        if not 0 <= index < len(self._lines):
            self.desk.say(f"there is no hit {index}; there are {len(self._lines)}")
            return
        line = self._lines[index]
        if remember:
            self._undo.append((index, line.accepted))
        run, number = self._places[index]
        run.judge_hit(number, accepted, reason)
        self._lines[index] = HitLine(index, accepted, reason, line.peak)  # the person's word stands for the checks'
        self._show()

    def _recall(self, run: Run) -> None:
        """Take up the hits of an earlier run."""
        for hit in run.hits:
            self._places.append((run, hit.index))
            self._signals.append(run.read(hit.start, hit.stop))
            peak = float(hit.info.get("peak", np.nan))
            self._lines.append(HitLine(len(self._lines), hit.accepted, hit.reason, peak))

    def _choose(self) -> None:
        """Keep the best hits only, if the plan asks for that."""
        best, accepted = self._plan.best, self.accepted
        if best is None or len(accepted) <= best:
            return
        kept = best_hits(self._transforms([self._signals[i] for i in accepted]), best)
        for k, index in enumerate(accepted):
            if k not in kept:
                self._set(index, False, f"not among the {best} that agree best")

    def _band(self, n: int) -> tuple[int, int]:
        """Lines of the excitation's band."""
        e, half = self.desk.rig.toml.excitation, self.desk.rig.rate / 2
        low = max(int(np.ceil(e.low / half * (n - 1))), 1)
        high = int((e.high or 0.8 * half) / half * (n - 1)) + 1
        return low, max(high, low + 1)

    def _show(self, last: NDArray | None = None) -> None:
        status = self.desk.status
        self.desk.done(len(self.accepted), self._plan.hits)
        self._say_what_to_do()
        status.hits = tuple(self._lines)
        status.hit = last if last is not None else status.hit
        running = shown(self._curves) if self.accepted else None
        status.curves = lambda: running

    def _curves(self) -> Curves:
        """FRFs of the accepted hits."""
        return curves(H1(self.processor())(self.recording()))

    def _say_what_to_do(self, busy: bool = False) -> None:
        status, plan = self.desk.status, self._plan
        status.waiting = self.complete and not plan.auto
        now = "hold still" if busy else "enough hits; say next" if status.waiting else "strike"
        status.state = f"point {self.desk.item.point}: {now} ({len(self.accepted)} of {plan.hits} accepted)"

    def processor(self) -> Hits:
        """How the hits are estimated from."""
        p = self.desk.rig.toml.processing
        return Hits(decay=p.decay, force_gate=p.force_gate)

    def recording(self) -> Recording:
        """The accepted hits, one after the other."""
        signals = [self._signals[i] for i in self.accepted]
        breaks = np.cumsum([s.shape[1] for s in signals])[:-1]
        item = self.desk.item
        return Recording(item.channels, np.hstack(signals), self.desk.rig.rate, tuple(breaks), label=item.key)
