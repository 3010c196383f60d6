"""What stops a run: limits, overloads, the person, gaps, a full disk, signals; the generator is off first."""

import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from drivers.block import Block
from drivers.simulated import SimulatedBench, SimulatedExciter
from labnnum.errors import ConfigError, DeviceLostError, EstimationError, SafetyError, StoreError
from labnnum.recording import Channel
from sessions import tables
from sessions.bench import measure
from sessions.display import Quiet
from sessions.guard import Guard
from sessions.rig_tables import SafetyTable
from sessions.runs import Run
from sessions.store import open_session

from .rigs import agreement, shaker_rig


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


STEPPED = (
    ('kind = "multisine"', 'kind = "stepped sine"\nlines = 4'),
    ("levels = [0.5, 2.0]", "levels = [1.0]"),
)


class Pressed(Quiet):
    """A person who says "stop" when `press` is called: it goes off at once, and is heard with the next commands."""

    def __init__(self):
        super().__init__()
        self.said = []

    def press(self):
        self.said.append("stop")
        self.urgent()

    def commands(self):
        said, self.said = self.said, []
        return said


def exciters(monkeypatch):
    """Those that the bench opens, as they come."""
    made, init = [], SimulatedExciter.__init__
    monkeypatch.setattr(SimulatedExciter, "__init__", lambda this, *args: (made.append(this), init(this, *args))[1])
    return made


def test_a_stop_between_two_items_ends_the_plan_before_anything_is_raised(tmp_path, monkeypatch):
    display, made, finish = Pressed(), exciters(monkeypatch), Run.finish
    monkeypatch.setattr(Run, "finish", lambda this, how: (finish(this, how), display.press())[0])
    outcome = measure(shaker_rig(tmp_path), tmp_path / "out.h5", display)
    assert outcome.items == {"multisine 0.5 #1": "complete", "multisine 2 #1": "stopped by the user"}
    assert len(made) == 2
    assert any(line.startswith("volts") for line in made[0].log)
    assert set(made[1].log) == {"off"}


def test_after_a_stop_neither_the_next_tone_nor_its_level_is_switched_on(tmp_path, monkeypatch):
    display, made, tone, asked = Pressed(), exciters(monkeypatch), SimulatedExciter.tone, []

    def pressed_before(this, frequency):
        asked.append(frequency)
        if len(asked) == 3:
            display.press()
        tone(this, frequency)

    monkeypatch.setattr(SimulatedExciter, "tone", pressed_before)
    outcome = measure(shaker_rig(tmp_path, *STEPPED), tmp_path / "out.h5", display)
    assert outcome.items == {"stepped-sine 1 #1": "stopped by the user"}
    (exciter,) = made
    after = exciter.log[exciter.log.index("off") :]
    assert set(after) == {"off"}


def test_between_two_runs_a_stop_switches_nothing(tmp_path, monkeypatch):
    display, made = Quiet(), exciters(monkeypatch)
    measure(shaker_rig(tmp_path), tmp_path / "out.h5", display)
    before = [list(e.log) for e in made]
    display.urgent()
    assert [e.log for e in made] == before


def test_a_lost_device_is_answered_by_the_thread_that_notices(tmp_path, monkeypatch):
    faults = ("[simulated.channel", "[simulated.faults]\nvanish = 0.7\n[simulated.channel")
    rig = shaker_rig(tmp_path, ("block = 256", "block = 64\nreal_time = true"), faults)
    threads, off = [], SimulatedExciter.off
    monkeypatch.setattr(
        SimulatedExciter, "off", lambda this: (threads.append(threading.current_thread().name), off(this))
    )
    with pytest.raises(DeviceLostError, match="unplugged"):
        measure(rig, tmp_path / "out.h5")
    assert threads[0] == "recorder"


def test_a_sample_that_is_no_number_keeps_no_limit():
    stored = tables.StoredChannel(Channel("force", "force", "reference"))
    off = []
    guard = Guard([stored], {"force": (None, 3.0)}, SafetyTable(), lambda: off.append("off"))
    guard(Block(np.array([[1.0, 2.0]]), 0, 0.0))
    with pytest.raises(SafetyError, match="'force' reached nan N, over its stop limit 3 N"):
        guard(Block(np.array([[1.0, np.nan]]), 2, 0.0))
    assert off == ["off"]


def test_a_tone_that_is_not_heard_at_full_volts_ends_the_run_with_the_output_off(tmp_path, monkeypatch):
    made = exciters(monkeypatch)
    rig = shaker_rig(
        tmp_path, *STEPPED, ("[simulated.channel", "[simulated.channel.force]\ngain = 0\n[simulated.channel")
    )
    with pytest.raises(
        SafetyError, match=r"'force' hears nothing of 5 Hz at 5.66 V RMS, the most that .* switched off"
    ):
        measure(rig, tmp_path / "out.h5")
    (exciter,) = made
    assert exciter.log[-1] == "off"
    assert exciter.volts == 0.0


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


@pytest.mark.parametrize("key", ["stop", "warn"])
def test_a_limit_beyond_the_inputs_range_is_refused(tmp_path, key):
    """10 V at 0.1 V per m/s^2 are 100 m/s^2: what would stop at 150 never stops."""
    with pytest.raises(ConfigError, match=rf"channel\[2\].*'a2': {key} 150 m/s\^2 .* 100 m/s\^2 at full_scale 10 V"):
        shaker_rig(tmp_path, ('node = "2"', f'{key} = 150\nnode = "2"'))
    assert shaker_rig(tmp_path, ('node = "2"', f'{key} = 100\nnode = "2"')).limits
    assert shaker_rig(tmp_path, ('node = "2"', f'{key} = 150\nfull_scale = 20.0\nnode = "2"')).limits


def test_a_stepped_sine_without_a_whole_stretch_ends_in_words(tmp_path):
    """Frames lost in every block: no tone lies whole in the recording, and the generator is off."""
    rig = shaker_rig(
        tmp_path, ('kind = "multisine"', 'kind = "stepped sine"\nlines = 4'), ("levels = [0.5, 2.0]", "levels = [1.0]"),
        ("[simulated.channel", "[simulated.faults]\ndropouts = 8.0\ndropout_frames = 20\n[simulated.channel"),
    )  # fmt: skip
    with pytest.raises(EstimationError, match=r"lost frames in each of 14 stretches of .* Output switched off"):
        measure(rig, tmp_path / "out.h5")


def test_gaps_stay_out_of_averages(tmp_path):
    faults = "[simulated.faults]\ndropouts = 0.3\ndropout_frames = 100\n"
    rig = shaker_rig(tmp_path, ("periods = 4", "periods = 30"), ("[simulated.channel", f"{faults}[simulated.channel"))
    outcome = measure(rig, tmp_path / "out.h5")
    with open_session(tmp_path / "out.h5") as session:
        gaps = [len(r.gaps()) for r in session.runs]
    assert max(gaps) > 0
    assert any("frames were lost" in m for m in outcome.messages)
    assert any(f"{max(gaps)} gaps in all: {100 * max(gaps)} frames lost" in m for m in outcome.messages)
    for name in ("multisine 0.5", "multisine 2"):
        assert agreement(rig, outcome.frfs[name]) < 1.6


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
