"""Whole runs of plans on the simulated bench: hammer, shaker, limits, interruptions and what comes out."""

import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from drivers.simulated import SimulatedBench, SimulatedExciter
from labnnum.errors import ConfigError, DeviceLostError, SafetyError, StoreError
from labnnum.response import frf
from sessions import bench
from sessions.bench import measure
from sessions.display import Quiet
from sessions.items import items, waveform
from sessions.model import read_model
from sessions.reprocess import FrfSettings, reprocess
from sessions.rig import parse_rig
from sessions.runs import Run
from sessions.store import open_session

MODEL = """
[structure]
kind = "chain"
base = "{base}"
[[structure.mass]]
node = "1"
mass = 2.0
[[structure.mass]]
node = "2"
mass = 1.0
[[structure.link]]
between = ["1", "ground"]
stiffness = 8e5
damping = 80.0
[[structure.link]]
between = ["1", "2"]
stiffness = 5e5
damping = 50.0
"""

HAMMER = """
[device]
rate = 2048
block = 512
[[channel]]
name = "hammer"
role = "reference"
unit = "N"
sensitivity = 0.02
[[channel]]
name = "a2"
unit = "m/s^2"
sensitivity = 0.05
node = "2"
direction = "x"
[excitation]
kind = "hammer"
high = 400
[trigger]
level = 10
pre = 0.05
duration = 0.7
[plan]
points = ["1:x", "2:x"]
hits = 3
[simulated]
seed = 3
bits = 16
[simulated.hammer]
interval = 1.0
peak = 150
tip = "hard rubber"
[simulated.channel.a2]
noise = 0.02
"""

SHAKER = """
[device]
rate = 1024
block = 256
[[channel]]
name = "{name}"
role = "{role}"
unit = "{unit}"
sensitivity = 0.2
{place}
[[channel]]
name = "a2"
unit = "m/s^2"
sensitivity = 0.1
node = "2"
direction = "x"
[generator]
max_volts = 8.0
[excitation]
kind = "multisine"
low = 5
high = 350
levels = [0.5, 2.0]
settle = 0.5
period = 1024
periods = 4
drop_periods = 1
[safety]
ramp = 0.1
[simulated]
seed = 3
gain = 5.0
[simulated.channel.a2]
noise = 0.01
"""
FORCE = {"name": "force", "role": "reference", "unit": "N", "place": 'node = "1"\ndirection = "x"'}
BASE = {"name": "table", "role": "base", "unit": "m/s^2", "place": 'direction = "x"'}


def rig_of(folder, text, base=""):
    (folder / "model.toml").write_text(MODEL.format(base=base))
    path = folder / "rig.toml"
    path.write_text(text)
    return parse_rig(text, path)


def hammer_rig(folder, *changes):
    return rig_of(folder, _changed(HAMMER, changes))


def shaker_rig(folder, *changes, place=FORCE):
    return rig_of(folder, _changed(SHAKER.format(**place), changes), "x" if place is BASE else "")


def _changed(text, changes):
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def agreement(rig, found):
    """RMS of the standardised error against the simulated structure."""
    model = read_model(rig.beside("model.toml"))
    lines = (found.frequency > 8) & (found.frequency < 340)
    exact = frf(model.structure, model.structure.nominal, found.frequency[lines], found.outputs, found.inputs)
    z = np.abs(found.value[:, :, lines] - exact) / np.sqrt(found.variance[:, :, lines])
    return float(np.sqrt(np.mean(z**2)))


# Hammer.


def test_hammer_plan_gives_the_frf_of_the_structure_at_every_point(tmp_path):
    rig = hammer_rig(tmp_path, ("hits = 3", "hits = 8"))
    display = Quiet()
    outcome = measure(rig, tmp_path / "out.h5", display)
    assert outcome.complete
    assert list(outcome.frfs) == ["hammer 1:x", "hammer 2:x", "all points"]
    whole = outcome.frfs["all points"]
    assert [c.dof for c in whole.inputs] == ["1:x", "2:x"]
    assert 0.7 < agreement(rig, whole) < 1.6
    last = display.last
    assert last is not None
    assert [p.done for p in last.progress] == [8, 8]
    assert last.curves is not None
    np.testing.assert_allclose(last.curves.magnitude, np.abs(outcome.frfs["hammer 2:x"].value[0]))


def test_what_is_stored_is_what_was_shown_with_a_gate_and_a_decay_too(tmp_path):
    rig = hammer_rig(
        tmp_path, ("[simulated]\n", "[processing]\ndecay = 4.0\nforce_gate = [0.005, 0.02]\n[simulated]\n")
    )
    display = Quiet()
    outcome = measure(rig, tmp_path / "out.h5", display)
    assert display.last is not None
    assert display.last.curves is not None
    stored = outcome.frfs["hammer 2:x"]
    np.testing.assert_allclose(display.last.curves.magnitude, np.abs(stored.value[0]), rtol=1e-9)
    assert stored.settings["window_decay"] == 4.0


def test_every_hit_is_kept_with_its_reason(tmp_path):
    rig = hammer_rig(
        tmp_path, ("peak = 150\n", "peak = 150\ndouble = 0.5\noverload = 0.2\n"), ("bits = 16", "bits = 12")
    )
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.complete
    with open_session(tmp_path / "out.h5") as session:
        hits = [h for run in session.runs for h in run.hits]
        recording = session.runs[0].recording()
        accepted = [h for h in session.runs[0].hits if h.accepted]
    rejected = [h for h in hits if not h.accepted]
    assert rejected
    assert all("double hit" in h.reason or "clipped" in h.reason for h in rejected)
    assert all(h.verdicts for h in hits)
    assert [(h.start, h.stop) for h in accepted] == list(recording.spans())


def test_the_person_rejects_undoes_and_goes_on(tmp_path):
    rig = hammer_rig(tmp_path, ('points = ["1:x", "2:x"]', 'points = ["1:x"]\nauto = false'))
    keys = Quiet([(1, "reject 0"), (2, "reject 1"), (2, "undo"), (4, "reject 9"), (5, "next")])
    outcome = measure(rig, tmp_path / "out.h5", keys)
    with open_session(tmp_path / "out.h5") as session:
        hits = session.runs[0].hits
    assert [h.accepted for h in hits][:2] == [False, True]
    assert hits[0].reason == "rejected by the user"
    assert [j.reason for j in hits[1].history][1:] == ["rejected by the user", "undone by the user"]
    assert len(hits) == 5
    assert any("there is no hit 9" in m for m in outcome.messages)
    assert keys.last is not None
    assert outcome.complete


def test_only_the_best_hits_stay(tmp_path):
    rig = hammer_rig(tmp_path, ("hits = 3", "hits = 5\nbest = 3"))
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.complete
    with open_session(tmp_path / "out.h5") as session:
        hits = session.runs[0].hits
    assert sum(h.accepted for h in hits) == 3
    assert sum("agree best" in h.reason for h in hits) == 2
    assert outcome.frfs["hammer 1:x"].n_averages == 3


def test_roving_sensor(tmp_path):
    changes = [
        ("sensitivity = 0.02\n", 'sensitivity = 0.02\nnode = "1"\ndirection = "x"\n'),
        ('node = "2"\ndirection = "x"\n', ""),
        ("hits = 3", 'hits = 3\nrove = "sensor"'),
    ]
    rig = hammer_rig(tmp_path, *changes)
    outcome = measure(rig, tmp_path / "out.h5")
    whole = outcome.frfs["all points"]
    assert [c.dof for c in whole.outputs] == ["1:x", "2:x"]
    assert [c.dof for c in whole.inputs] == ["1:x"]
    assert whole.coherence is not None
    assert agreement(rig, whole) < 2.5


def test_a_point_that_gives_nothing_is_given_up(tmp_path):
    rig = hammer_rig(tmp_path, ("peak = 150\n", "peak = 150\ndouble = 1.0\n"), ("hits = 3", "hits = 3\nmost = 4"))
    outcome = measure(rig, tmp_path / "out.h5")
    assert not outcome.complete
    assert outcome.items == {"hammer 1:x": "gave up", "hammer 2:x": "gave up"}
    assert any("giving up" in m for m in outcome.messages)


# Shaker.


@pytest.mark.parametrize("place", [FORCE, BASE], ids=["force", "base"])
@pytest.mark.parametrize("shaker", ["", "[simulated.shaker]\nmass = 0.4\n"], ids=["ideal", "electrodynamic"])
def test_levels_are_held_and_the_frf_is_the_structures(tmp_path, place, shaker):
    rig = shaker_rig(tmp_path, ("[simulated.channel", f"{shaker}[simulated.channel"), place=place)
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.complete
    for name, level in (("multisine 0.5", 0.5), ("multisine 2", 2.0)):
        assert 0.5 < agreement(rig, outcome.frfs[name]) < 1.6
        with open_session(tmp_path / "out.h5") as session:
            run = next(r for r in session.runs if r.level == level)
            held = run.hits[0]
            rms = run.read(held.start, held.stop)[0].std()
        assert rms == pytest.approx(level, rel=0.05)
        assert held.stop - held.start == 5 * 1024


def test_realisations_share_their_lines_and_all_of_them_are_estimated(tmp_path):
    """Lines are known from what was played: none is lost where the force sinks into the noise at a resonance."""
    rig = shaker_rig(tmp_path, ("levels = [0.5, 2.0]", "levels = [1.0]\nrealisations = 3\nodd = true\ndetection = 4"))
    path = tmp_path / "s.h5"
    frf = measure(rig, path).frfs["multisine 1"]
    played = [waveform(rig.toml.excitation, rig.rate, r) for r in range(3)]
    for drive in played:
        np.testing.assert_array_equal(drive.lines, played[0].lines)
    assert not np.array_equal(played[0].samples, played[1].samples)
    step = rig.rate / rig.toml.excitation.period
    np.testing.assert_allclose(frf.frequency, played[0].lines * step)
    with open_session(path, "a") as session:
        ((_, again),) = reprocess(session, FrfSettings())
    np.testing.assert_array_equal(again.value, frf.value)


@pytest.mark.parametrize("kind", ["random", "burst random", "periodic random", "chirp"])
def test_other_excitations(tmp_path, kind):
    changes = [('kind = "multisine"', f'kind = "{kind}"\nduration = 30'), ("levels = [0.5, 2.0]", "levels = [1.0]")]
    rig = shaker_rig(tmp_path, *changes)
    outcome = measure(rig, tmp_path / "out.h5")
    found = outcome.frfs[f"{kind.replace(' ', '-')} 1"]
    # a Hann window leaks a little where the structure is lightly damped; what fits the block does not leak
    assert 0.5 < agreement(rig, found) < (2.5 if kind == "random" else 1.6)


def test_stepped_sine_up_and_down(tmp_path):
    changes = [
        ('kind = "multisine"', 'kind = "stepped sine"\nlines = 12\ndirections = ["up", "down"]'),
        ("levels = [0.5, 2.0]", "levels = [1.0]"),
    ]
    rig = shaker_rig(tmp_path, *changes)
    outcome = measure(rig, tmp_path / "out.h5")
    up, down = outcome.frfs["stepped-sine 1 up"], outcome.frfs["stepped-sine 1 down"]
    model = read_model(rig.beside("model.toml"))
    for found in (up, down):
        exact = frf(model.structure, [], found.frequency, found.outputs, found.inputs)
        z = np.abs(found.value - exact) / np.sqrt(found.variance)
        assert 0.5 < np.sqrt(np.mean(z**2)) < 1.6
    with open_session(tmp_path / "out.h5") as session:
        hits = session.runs[0].hits
    assert [h.info["direction"] for h in hits] == ["up"] * 12 + ["down"] * 12
    assert max(abs(h.info["off"]) for h in hits) <= 0.05


def test_a_recording_without_excitation(tmp_path):
    rig = shaker_rig(tmp_path, ('kind = "multisine"', 'kind = "none"\nduration = 3.0'))
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.items == {"record": "complete"}
    with open_session(tmp_path / "out.h5") as session:
        recording = session.recordings()[0]
    assert recording.duration >= 3.0
    assert recording.data[1].std() == pytest.approx(0.01, rel=0.1)


class Spy:
    """Notes in which order the bench acts."""

    def __init__(self, monkeypatch):
        self.log = []
        off, stop, append = SimulatedExciter.off, SimulatedBench.stop, Run.append

        def noted(name, call):
            def wrapped(this, *args):
                self.log.append(name)
                return call(this, *args)

            return wrapped

        monkeypatch.setattr(SimulatedExciter, "off", noted("off", off))
        monkeypatch.setattr(SimulatedBench, "stop", noted("stop", stop))
        monkeypatch.setattr(Run, "append", noted("append", append))


def test_a_limit_switches_off_first_and_keeps_the_block(tmp_path, monkeypatch):
    rig = shaker_rig(tmp_path, ("sensitivity = 0.2\n", "sensitivity = 0.2\nwarn = 1.0\nstop = 3.0\n"))
    spy = Spy(monkeypatch)
    with pytest.raises(SafetyError, match=r"'force' reached .* over its stop limit 3 N: the output"):
        measure(rig, tmp_path / "out.h5")
    tail = spy.log[len(spy.log) - spy.log[::-1].index("append") - 2 :]
    assert tail[:2] == ["off", "append"]
    assert "stop" in tail
    with open_session(tmp_path / "out.h5") as session:
        ended = [r.finished for r in session.runs]
    assert ended[0] == "complete"
    assert ended[1].startswith("abort: channel 'force'")


def test_stop_switches_off_first(tmp_path, monkeypatch):
    rig = shaker_rig(tmp_path)
    spy = Spy(monkeypatch)
    outcome = measure(rig, tmp_path / "out.h5", Quiet([(0, "stop")]))
    assert not outcome.complete
    assert spy.log.index("off") < len(spy.log) - 1 - spy.log[::-1].index("stop")
    assert "append" not in spy.log[spy.log.index("off") :]
    assert outcome.items["multisine 0.5 #1"] == "stopped by the user"


def test_overload_and_lost_frames_can_stop(tmp_path):
    rig = shaker_rig(
        tmp_path, ("ramp = 0.1", 'ramp = 0.1\noverload = "stop"'), ('unit = "N"', 'unit = "N"\nfull_scale = 0.3')
    )
    with pytest.raises(SafetyError, match="'force' met the end of its range"):
        measure(rig, tmp_path / "out.h5")


def test_a_clipped_run_is_kept_and_gives_no_frf(tmp_path):
    rig = shaker_rig(tmp_path, ('unit = "m/s^2"\n', 'unit = "m/s^2"\nfull_scale = 0.05\n'))
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.complete
    assert "multisine 2" not in outcome.frfs
    assert any(m.startswith("no FRF of multisine 2") for m in outcome.messages)
    assert any("met the end of its range" in m for m in outcome.messages)


def test_a_level_out_of_reach_is_said(tmp_path):
    rig = shaker_rig(tmp_path, ("max_volts = 8.0", "max_volts = 1.0"))
    with pytest.raises(SafetyError, match="more than max_volts 1"):
        measure(rig, tmp_path / "out.h5")
    rig = shaker_rig(tmp_path, ("gain = 5.0", "gain = 1e-9"))
    with pytest.raises(SafetyError, match=r"more than max_volts|does not settle"):
        measure(rig, tmp_path / "other.h5")


def test_gaps_stay_out_of_averages(tmp_path):
    faults = "[simulated.faults]\ndropouts = 0.3\ndropout_frames = 100\n"
    rig = shaker_rig(tmp_path, ("periods = 4", "periods = 30"), ("[simulated.channel", f"{faults}[simulated.channel"))
    outcome = measure(rig, tmp_path / "out.h5")
    with open_session(tmp_path / "out.h5") as session:
        gaps = [len(r.gaps()) for r in session.runs]
    assert max(gaps) > 0
    assert any("frames were lost" in m for m in outcome.messages)
    for name in ("multisine 0.5", "multisine 2"):
        assert agreement(rig, outcome.frfs[name]) < 1.6


# Interruptions.


def test_a_lost_device_leaves_what_was_recorded_and_the_plan_goes_on(tmp_path, monkeypatch):
    rig = hammer_rig(tmp_path)
    broken = replace(rig, toml=rig.toml.model_copy(update={"simulated": _vanishing(rig)}))
    with pytest.raises(DeviceLostError, match="unplugged"):
        measure(broken, tmp_path / "out.h5")
    with open_session(tmp_path / "out.h5") as session:
        assert session.runs[0].finished.startswith("abort: the simulated device was unplugged")
        before = [(h.start, h.accepted) for h in session.runs[0].hits]
    assert before
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.complete
    with open_session(tmp_path / "out.h5") as session:
        first = [r for r in session.runs if r.info["item"] == "hammer 1:x"]
        assert [(h.start, h.accepted) for h in first[0].hits] == before
        assert sum(h.accepted for r in first for h in r.hits) == 3


def _vanishing(rig):
    s = rig.toml.simulated
    return s.model_copy(update={"faults": s.faults.model_copy(update={"vanish": 2.2})})


@pytest.mark.parametrize("make", [hammer_rig, shaker_rig])
def test_a_plan_resumed_between_items_gives_the_same_bits(tmp_path, make):
    rig = make(tmp_path)
    whole = measure(rig, tmp_path / "whole.h5")

    class Evening(Quiet):
        """Stops when the second item begins."""

        def commands(self):
            current = [p.key for p in self.last.progress if p.current] if self.last else []
            return ["stop"] if current == [items(rig)[1].key] else []

        def wants(self):
            return True

    one = measure(rig, tmp_path / "parts.h5", Evening())
    assert not one.complete
    parts = measure(rig, tmp_path / "parts.h5")
    assert parts.complete
    assert list(parts.frfs) == list(whole.frfs)
    for name, found in whole.frfs.items():
        if make is shaker_rig or name == "hammer 1:x":
            np.testing.assert_array_equal(parts.frfs[name].value, found.value)


def test_a_plan_resumed_in_the_middle_of_a_point_gives_the_same_bits(tmp_path):
    """The same blows, recorded in one run or in two, on two days."""
    text = HAMMER.replace('points = ["1:x", "2:x"]', 'points = ["1:x"]').replace("hits = 3", "hits = 4")
    rig = rig_of(tmp_path, text)
    whole = measure(rig, tmp_path / "whole.h5")
    with open_session(tmp_path / "whole.h5") as session:
        blocks = list(session.runs[0].replay())
        cut = (session.runs[0].hits[1].stop + session.runs[0].hits[2].start) // 2 // 512

    played = replay_of(rig, [blocks[:cut], blocks[cut:]])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "devices", played)
        with pytest.raises(DeviceLostError):
            measure(rig, tmp_path / "parts.h5")
        parts = measure(rig, tmp_path / "parts.h5")
    assert parts.complete
    found, expected = parts.frfs["hammer 1:x"], whole.frfs["hammer 1:x"]
    np.testing.assert_array_equal(found.value, expected.value)
    np.testing.assert_array_equal(found.coherence, expected.coherence)
    np.testing.assert_array_equal(found.variance, expected.variance)


def replay_of(rig, days):
    """Devices that play one list of blocks at each attempt, and are lost at its end."""
    from contextlib import contextmanager

    from drivers.digitiser import Digitiser
    from sessions.devices import Devices

    class Day(Digitiser):
        paced = False
        rate = rig.rate
        n_channels = 2

        def __init__(self, blocks):
            self._blocks = iter(blocks)

        def open(self): ...

        def start(self): ...

        def stop(self): ...

        def read(self, timeout=5.0):
            block = next(self._blocks, None)
            if block is None:
                raise DeviceLostError("the day is over")
            return block

    left = iter(days)

    @contextmanager
    def played(rig, item, attempt=0):
        yield Devices(Day(next(left)))

    return played


def test_a_second_session_needs_the_same_rig(tmp_path):
    rig = hammer_rig(tmp_path)
    measure(rig, tmp_path / "out.h5")
    other = hammer_rig(tmp_path, ("hits = 3", "hits = 4"))
    with pytest.raises(ConfigError, match=r"begun with another rig\.toml"):
        measure(other, tmp_path / "out.h5")


def test_measuring_a_complete_plan_again_changes_nothing(tmp_path):
    rig = hammer_rig(tmp_path)
    measure(rig, tmp_path / "out.h5")
    with open_session(tmp_path / "out.h5") as session:
        before = len(session.frfs()), len(session.runs)
    again = measure(rig, tmp_path / "out.h5")
    assert again.complete
    with open_session(tmp_path / "out.h5") as session:
        assert (len(session.frfs()), len(session.runs)) == before


def test_a_full_disk_switches_off_and_says_so(tmp_path, monkeypatch):
    rig = shaker_rig(tmp_path)
    count = 0
    append = Run.append

    def full(run, block):
        nonlocal count
        count += 1
        if count > 20:
            raise StoreError("the disk is full")
        return append(run, block)

    monkeypatch.setattr(Run, "append", full)
    log = []
    off = SimulatedExciter.off
    monkeypatch.setattr(SimulatedExciter, "off", lambda this: (log.append("off"), off(this)))
    with pytest.raises(StoreError, match="full"):
        measure(rig, tmp_path / "out.h5")
    assert log
    with open_session(tmp_path / "out.h5") as session:
        assert session.runs[0].n_samples == 20 * 256


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([("levels = [0.5, 2.0]\n", "")], "at least one level"),
        ([('role = "reference"', 'quantity = "force"\nrole = "monitor"')], "reference or base"),
        ([("[generator]\nmax_volts = 8.0\n", "[generator]\nmax_volts = -1\n")], "max_volts"),
        ([("seed = 3", "seed = 3\n[simulated.parameters]\nk = 1.0")], "the model has none"),
    ],
)
def test_bad_rigs(tmp_path, changes, words):
    with pytest.raises(ConfigError, match=words):
        measure(shaker_rig(tmp_path, *changes), tmp_path / "out.h5")


def test_a_stored_session_is_replayed_to_the_same_bits(tmp_path):
    rig = hammer_rig(tmp_path)
    whole = measure(rig, tmp_path / "whole.h5")
    again = hammer_rig(tmp_path, ("rate = 2048", 'kind = "replay"\nsession = "whole.h5"\nrate = 2048'))
    played = measure(again, tmp_path / "again.h5")
    assert played.complete
    for name, found in whole.frfs.items():
        np.testing.assert_array_equal(played.frfs[name].value, found.value)
    missing = hammer_rig(tmp_path, ("rate = 2048", 'kind = "replay"\nrate = 2048'))
    with pytest.raises(ConfigError, match=r"device\.session"):
        measure(missing, tmp_path / "none.h5")


def test_command(tmp_path):
    import json

    from typer.testing import CliRunner

    from sessions.cli import app

    hammer_rig(tmp_path)
    out = tmp_path / "out.h5"
    told = CliRunner().invoke(app, ["measure", str(tmp_path / "rig.toml"), "-o", str(out), "--quiet", "--json"])
    assert told.exit_code == 0, told.output
    said = json.loads(told.stdout)
    assert said["complete"]
    assert said["frfs"]["hammer 1:x"]["averages"] == 3.0
    text = CliRunner().invoke(app, ["measure", str(tmp_path / "rig.toml"), "-o", str(out), "--quiet"])
    assert "hammer 2:x: complete" in text.stdout


def test_a_hit_at_another_point_is_found(tmp_path):
    rig = hammer_rig(tmp_path)
    measure(rig, tmp_path / "whole.h5")
    with open_session(tmp_path / "whole.h5") as session:
        here, there = (list(run.replay()) for run in session.runs)
        cut = session.runs[0].hits[1].stop // 512 + 1
    last = here[cut - 1]
    moved = [replace(b, start=b.start + last.start + 512) for b in there]
    again = rig_of(tmp_path, HAMMER.replace('points = ["1:x", "2:x"]', 'points = ["1:x"]'))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "devices", replay_of(again, [here[:cut] + moved]))
        with pytest.raises(DeviceLostError):
            measure(again, tmp_path / "mixed.h5")
    with open_session(tmp_path / "mixed.h5") as session:
        hits = session.runs[0].hits
    assert [h.accepted for h in hits[:2]] == [True, True]
    assert not hits[2].accepted
    assert "disagrees with the others on a2" in hits[2].reason


@pytest.fixture
def interruptible():
    """Children heed SIGINT even where this process was started in the background, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="needs POSIX signals")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.usefixtures("interruptible")
def test_signals_end_a_run_in_order(tmp_path, name):
    shaker_rig(tmp_path, ("block = 256", "block = 64\nreal_time = true"), ("periods = 4", "periods = 400"))
    out = tmp_path / "out.h5"
    words = ["-m", "sessions.cli", "measure", str(tmp_path / "rig.toml"), "-o", str(out), "--quiet"]
    command = subprocess.Popen([sys.executable, *words], stderr=subprocess.PIPE, text=True)
    try:
        until = time.monotonic() + 60
        while not _stored(out):
            assert time.monotonic() < until
            time.sleep(0.1)
        command.send_signal(getattr(signal, name))
        said = command.communicate(timeout=30)[1]
    finally:
        command.kill()
    assert command.returncode == 130
    assert said.startswith("labnnum: interrupted")
    with open_session(out) as session:
        assert session.runs[0].finished == "interrupted"


def _stored(path):
    if not path.exists():
        return 0
    with open_session(path) as session:
        return session.runs[0].n_samples if session.runs else 0
