"""Bench: a plan is run on the rig's devices, item by item, into a session that can be taken up again another day."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from labnnum.bands import Band
from labnnum.errors import ConfigError, InputError, LabnnumError, StoreError
from labnnum.frf import Frf
from labnnum.quality import coherence_verdicts
from labnnum.recording import Recording
from labnnum.sine import tone_frf
from sessions.calibration import run_info, without_inputs
from sessions.desk import Desk, UserStopError
from sessions.devices import devices
from sessions.display import Display, Quiet
from sessions.guard import Guard
from sessions.hammer import HammerRun
from sessions.items import Item, items, runs_of, waveform
from sessions.pooling import Used, averaged
from sessions.recorder import Recorder
from sessions.reprocess import FrfSettings, estimate_runs
from sessions.rig import Rig
from sessions.runs import COMPLETE, Run
from sessions.shaker import ShakerRun, SteppedRun
from sessions.snapshot import Progress
from sessions.store import Session, create_session, discard_empty, open_session

IDENTITY = ("name", "basis", "periodic", "burst")
"""Settings in which a stored FRF must agree with one of the same values, so that it need not be stored again."""

STOPPED, GO_ON = "stopped by the user", "the same command goes on from here"


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a plan came to.

    Parameters
    ----------
    path : Path
        The session.
    items : mapping
        Key of each item -> how it ended; "" if it is still to do.
    frfs : mapping
        Name -> FRF, as stored.
    messages : tuple of str
        What the bench had to say.
    """

    path: Path
    items: Mapping[str, str]
    frfs: Mapping[str, Frf]
    messages: tuple[str, ...] = field(default=())

    @property
    def complete(self) -> bool:
        """Whether everything that the plan asks for is done."""
        return all(how == COMPLETE for how in self.items.values())


def measure(rig: Rig, path: str | Path, display: Display | None = None, model_text: str = "") -> Outcome:
    """Run what is left of the rig's plan into the session at `path`, and estimate what it holds.

    Parameters
    ----------
    rig : Rig
    path : path
        A new session, or one that was begun with the same rig.toml: it goes on where it ended.
    display : Display, optional
        Shows what goes on and hands over the person's commands; quiet if not given.
    model_text : str
        model.toml, kept in a new session.

    Returns
    -------
    Outcome

    Raises
    ------
    ConfigError
        If the session was begun with another rig.toml.
    SafetyError
        If a limit was passed or the person stopped; the generator is off, and everything before is stored.
    DriverError, StoreError
        If a device or the disk failed; the generator is off, and everything acknowledged before is stored.
    """
    path, display = Path(path), display or Quiet()
    try:
        outcome = _measured(rig, path, display, model_text)
    except BaseException as error:
        interrupted = isinstance(error, KeyboardInterrupt)
        display.end(f"interrupted; {GO_ON}" if interrupted else str(error), not interrupted)
        raise
    left = sum(how != COMPLETE for how in outcome.items.values())
    stopped = next((m for m in outcome.messages if m.startswith(STOPPED)), "")
    display.end(stopped or (f"{left} of {len(outcome.items)} items are left to do" if left else "the plan is complete"))
    return outcome


def _measured(rig: Rig, path: Path, display: Display, model_text: str) -> Outcome:
    plan, new = items(rig), not path.exists()
    session = _session(rig, path, model_text)
    try:
        with session:
            return _run_plan(session, rig, plan, display)
    except BaseException:
        if new:  # failed before anything was recorded: an empty session would refuse the rig.toml that is put right
            with suppress(LabnnumError, OSError):
                discard_empty(path)
        raise


def _run_plan(session: Session, rig: Rig, plan: Sequence[Item], display: Display) -> Outcome:
    messages: list[str] = [session.notice] if session.notice else []
    try:
        for item in plan:
            if _ended(session, item) != COMPLETE:
                _measure(session, rig, item, display, progress(session, rig, plan), messages)
    except UserStopError:
        messages.append(f"{STOPPED}; {GO_ON}")
    frfs = results(session, rig, plan, messages)
    ended = {item.key: _ended(session, item) for item in plan}
    return Outcome(session.path, ended, frfs, tuple(messages))


def progress(session: Session, rig: Rig, plan: Sequence[Item]) -> list[Progress]:
    """How far each item of the plan is."""
    out = []
    for item in plan:
        runs = runs_of(item, session.runs)
        complete = _ended(session, item) == COMPLETE
        if item.kind == "hammer":
            accepted, wanted = sum(h.accepted for r in runs for h in r.hits), rig.toml.plan.hits
            out.append(Progress(item.key, max(accepted, wanted) if complete else accepted, wanted))
        else:
            out.append(Progress(item.key, int(complete), 1))
    return out


def _session(rig: Rig, path: Path, model_text: str) -> Session:
    if not path.exists():
        return create_session(path, rig_text=rig.text, model_text=model_text)
    session = open_session(path, "a")
    if session.rig_text != rig.text:
        session.close()
        raise ConfigError(
            f"{path}: was begun with another {rig.path.name}; give a new session with -o, or take up the rig.toml"
            " that is stored in it (labnnum info --rig)"
        )
    return session


def _ended(session: Session, item: Item) -> str:
    """How the item ended: "complete" if any of its runs did, else as its last run."""
    ends = [r.finished for r in runs_of(item, session.runs)]
    return COMPLETE if COMPLETE in ends else ends[-1] if ends else ""


def _measure(
    session: Session, rig: Rig, item: Item, display: Display, done: Sequence[Progress], messages: list[str]
) -> None:
    """One item, as a run of the session that says how it ended."""
    earlier = runs_of(item, session.runs)
    with devices(rig, item, sum(len(r.hits) for r in earlier)) as found:
        run = _begin(session, rig, item)
        how = "interrupted"
        try:
            how = _take(rig, item, run, earlier, found, display, done, messages)
        except UserStopError:
            how = STOPPED
            raise
        except StoreError:
            how = ""  # the disk takes no more, not even how it ended
            raise
        except LabnnumError as error:
            how = f"abort: {error}"
            raise
        finally:
            if found.exciter is not None:
                found.exciter.off()
            if how:
                run.finish(how)


def _begin(session: Session, rig: Rig, item: Item) -> Run:
    e = rig.toml.excitation
    info: dict[str, Any] = {"item": item.key, "excitation": e.model_dump(), "realisation": item.realisation}
    info["seed"] = e.seed + item.realisation
    if e.periodic:
        info["lines"] = waveform(e, rig.rate, item.realisation).lines
    info |= run_info(rig.calibration)
    return session.start_run(
        item.stored,
        rig.rate,
        level=item.level,
        period=e.period if e.periodic else 0,
        drop_periods=e.drop_periods if e.periodic else 0,
        label=item.key,
        info=info,
    )


def _take(rig, item, run, earlier, found, display, done, messages) -> str:
    off = found.exciter.off if found.exciter is not None else lambda: None
    guard = Guard(item.stored, rig.limits, rig.toml.safety, off)
    with Recorder(found.digitiser, run, guard) as recorder:
        said: list[str] = []
        try:
            desk = Desk(rig, item, run, recorder, guard, display, found.exciter, done)
            said = desk.status.messages
            how = _run(desk, earlier)
            display.show(desk.snapshot())
            return how
        finally:
            off()
            texts = [*guard.warnings, *_gaps(guard, recorder), *said, *found.digitiser.notes]
            texts += found.exciter.notes if found.exciter is not None else ()
            messages += [f"{item.key}: {text}" for text in texts]


def _gaps(guard: Guard, recorder: Recorder) -> list[str]:
    """Where there was more than the one gap that has been told: how many."""
    if guard.gaps < 2:
        return []
    return [f"{guard.gaps} gaps in all: {recorder.lost} frames lost, {recorder.overflows} overflows"]


def _run(desk: Desk, earlier: Sequence[Run]) -> str:
    kind = desk.rig.toml.excitation.kind
    if kind == "hammer":
        hammer = HammerRun(desk, earlier)
        hammer.measure()
        return COMPLETE if hammer.enough else "gave up"
    if kind == "none":
        _listen(desk)
        return COMPLETE
    (SteppedRun(desk) if kind == "stepped sine" else ShakerRun(desk)).measure()
    return COMPLETE


def _listen(desk: Desk) -> None:
    """Record for the duration asked for, whatever excites the structure."""
    frames = round(desk.rig.toml.excitation.duration * desk.rig.rate)
    desk.status.state = "recording"
    for _ in desk.blocks():
        desk.done(min(desk.position, frames), frames)
        if desk.position >= frames:
            return


def results(session: Session, rig: Rig, plan: Sequence[Item], messages: list[str] | None = None) -> dict[str, Frf]:
    """FRFs of what the session holds, stored unless they are there already: the same hits give the same bits.

    Where data give none, `messages` say why; and which accepted hits are not used, and which responses fall short of
    the coherence that the rig asks for.
    """
    out: dict[str, Frf] = {}
    if rig.toml.excitation.kind == "none":
        return out
    for name, runs in _groups(session, plan).items():
        try:
            found = _estimates(name, runs, rig)
        except InputError as error:  # what was recorded stays; it may be estimated from with other settings
            if messages is not None:
                messages.append(f"no FRF of {name}: {error}")
            continue
        for title, (frf, used) in found.items():
            out[title] = _stored(session, title, frf, used.basis)
            if messages is not None:
                messages += [f"{title}: {text}" for text in (*used.remarks, *_incoherent(frf, rig))]
    roved = _assembled(out, rig)
    if roved is not None:
        basis = {"points": {k: f.settings.get("basis") for k, f in out.items()}}
        out["all points"] = _stored(session, "all points", roved, basis)
    return out


def _incoherent(frf: Frf, rig: Rig) -> list[str]:
    """What falls short of `processing.coherence` in the excitation's band, each response with the likely cause."""
    e = rig.toml.excitation
    low, high = max(e.low, float(frf.frequency[0])), min(e.high or 0.4 * rig.rate, float(frf.frequency[-1]))
    if not (low < high and np.any((frf.frequency >= low) & (frf.frequency <= high))):
        return []
    found = coherence_verdicts(frf, rig.toml.processing.coherence, [Band(low, high)])
    return [v.reason for v in found if not v.ok and np.isfinite(v.value)]


def _groups(session: Session, plan: Sequence[Item]) -> dict[str, list[Run]]:
    """Runs that belong in one FRF: all of a point, all realisations of a level; only what was accepted."""
    out: dict[str, list[Run]] = {}
    for item in plan:
        name = item.key.split(" #")[0]
        kept = [r for r in runs_of(item, session.runs) if not r.unusable]
        if kept:
            out.setdefault(name, []).extend(kept)
    return out


def _estimates(name: str, runs: Sequence[Run], rig: Rig) -> dict[str, tuple[Frf, Used]]:
    """Title -> FRF, and what of the runs it rests on."""
    recordings = [r.recording() for r in runs]
    if rig.toml.excitation.kind == "stepped sine":
        return _stepped(name, runs, recordings)
    return {name: estimate_runs(runs, recordings, settings(rig))}


def settings(rig: Rig) -> FrfSettings:
    """How the rig's recordings are estimated."""
    p, e = rig.toml.processing, rig.toml.excitation
    if e.kind == "hammer":
        lead, gate = p.force_gate or (None, 0.0)
        method = "H1" if p.estimator in (None, "periodic") else p.estimator
        return FrfSettings(method, hits=True, decay=p.decay, gate=gate, lead=lead)
    if e.periodic and p.estimator in (None, "periodic"):
        return FrfSettings("periodic")
    method = p.estimator or "H1"
    if e.periodic or e.kind == "burst random":
        return FrfSettings(method, e.period, "boxcar", 0.0, hits=False)
    return FrfSettings(method, p.segment, p.window, p.overlap, hits=False)


def _stepped(name: str, runs: Sequence[Run], recordings: Sequence[Recording]) -> dict[str, tuple[Frf, Used]]:
    """An FRF of each direction: the mean over realisations, weighted by their variances."""
    made: dict[str, list[Frf]] = {}
    basis: dict[str, dict[str, list[int]]] = {}
    for run, recording in zip(runs, recordings, strict=True):
        hits = [h for h in run.hits if h.accepted]
        for direction in dict.fromkeys(h.info["direction"] for h in hits):
            chosen = [h for h in hits if h.info["direction"] == direction]
            frf = tone_frf(recording, [(h.start, h.stop) for h in chosen], [h.info["frequency"] for h in chosen])
            title = f"{name} {direction}"
            made.setdefault(title, []).append(without_inputs(frf, [run]))
            basis.setdefault(title, {})[str(run.index)] = [h.index for h in chosen]
    return {title: (averaged(frfs, by_variance=True), Used(basis[title])) for title, frfs in made.items()}


def _stored(session: Session, name: str, frf: Frf, basis: Mapping[str, Any]) -> Frf:
    """`frf` with what it rests on among its settings; added to the session if it is not there."""
    told = {**frf.settings, "basis": dict(basis), "name": name}
    made = replace(frf, settings=told)
    for old in session.frfs():
        if all(old.settings.get(key) == told.get(key) for key in IDENTITY) and _same(old, frf):
            return made
    session.add_frf(made, name=name)
    return made


def _same(one: Frf, other: Frf) -> bool:
    return one.value.shape == other.value.shape and bool(np.array_equal(one.value, other.value))


def _assembled(found: Mapping[str, Frf], rig: Rig) -> Frf | None:
    """One FRF of all points of a roving plan; None where there is one point, or the points' lines differ."""
    parts = list(found.values())
    if any(p.frequency[0] > 0 for p in parts):  # some inputs' high-passes took the line at 0 Hz
        parts = [p.at(p.frequency > 0) for p in parts]
    if rig.toml.excitation.kind != "hammer" or len(parts) < 2:
        return None
    if any(not np.array_equal(p.frequency, parts[0].frequency) for p in parts):
        return None
    first = parts[0]
    averages = float(min(p.n_averages for p in parts))
    told = {**{k: v for k, v in first.settings.items() if k not in ("basis", "name")}, "points": len(parts)}
    if rig.toml.plan.rove == "hammer":
        inputs = tuple(replace(p.inputs[0], name=f"{p.inputs[0].name} {p.inputs[0].dof}") for p in parts)
        value = np.concatenate([p.value for p in parts], axis=1)
        variance = _joined([p.variance for p in parts], 1)
        return Frf(first.frequency, value, first.outputs, inputs, None, variance, averages, first.estimator, told)
    moved = [
        [c for c in p.outputs if any(c.signal != q.signal for q in _fixed(parts, c.name))] or list(p.outputs)
        for p in parts
    ]
    rows = [[p.outputs.index(c) for c in m] for p, m in zip(parts, moved, strict=True)]
    outputs = tuple(replace(c, name=f"{c.name} {c.dof}") for m in moved for c in m)
    value = np.concatenate([p.value[r] for p, r in zip(parts, rows, strict=True)])
    variance = _joined([None if p.variance is None else p.variance[r] for p, r in zip(parts, rows, strict=True)], 0)
    coherence = _joined([None if p.coherence is None else p.coherence[r] for p, r in zip(parts, rows, strict=True)], 0)
    return Frf(first.frequency, value, outputs, first.inputs, coherence, variance, averages, first.estimator, told)


def _fixed(parts: Sequence[Frf], name: str) -> list[Any]:
    """Channels called `name` in every part."""
    return [c for p in parts for c in p.outputs if c.name == name]


def _joined(arrays: Sequence[Any], axis: int):
    return None if any(a is None for a in arrays) else np.concatenate(arrays, axis=axis)
