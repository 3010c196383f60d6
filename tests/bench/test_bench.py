"""Rigs that cannot be run, replayed sessions, and the command."""

import re

import numpy as np
import pytest

from labnnum.errors import ConfigError, DeviceNotFoundError
from sessions.bench import measure
from sessions.display import Display
from sessions.store import open_session

from .rigs import hammer_rig, shaker_rig


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([("levels = [0.5, 2.0]\n", "")], "at least one level"),
        ([('role = "reference"', 'quantity = "force"\nrole = "monitor"')], "reference or base"),
        ([("[generator]\nmax_volts = 8.0\n", "[generator]\nmax_volts = -1\n")], "max_volts"),
        ([("seed = 3", "seed = 3\n[simulated.parameters]\nk = 1.0")], "the model has none"),
        ([("max_volts = 8.0", 'kind = "scpi"\nmax_volts = 8.0')], "'scpi' does not drive a simulated device"),
    ],
)
def test_bad_rigs(tmp_path, changes, words):
    with pytest.raises(ConfigError, match=words):
        measure(shaker_rig(tmp_path, *changes), tmp_path / "out.h5")


TRIGGER = "[trigger]\nlevel = 10"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([(TRIGGER, '[trigger]\nchannel = "a2"\nlevel = 10')], r"trigger.channel: 'a2' has the role response"),
        ([(TRIGGER, "[trigger]\nlevel = 5000")], r"level: 5000 N cannot be reached: .* ends at 500 N"),
        ([('unit = "m/s^2"', 'unit = "m/s^2"\nrole = "base"')], "none has the role response"),
        ([("[excitation]", '[[channel]]\nname = "f2"\nrole = "reference"\nunit = "N"\nsensitivity = 1\n[excitation]')],
         "channel 'f2': a hammer plan has one input, 'hammer'"),
        ([('["1:x", "2:x"]', '["1:x", "2:x", "1:x"]')], "plan: points: '1:x' stands there twice"),
        ([("hits = 3", "hits = 3\nbest = 4")], "plan: best: 4 hits cannot be chosen from 3"),
    ],
)  # fmt: skip
def test_hammer_plans_that_cannot_be_measured_are_refused_before_anybody_strikes(tmp_path, changes, words):
    with pytest.raises(ConfigError, match=words):
        measure(hammer_rig(tmp_path, *changes), tmp_path / "out.h5")
    assert not (tmp_path / "out.h5").exists()


def test_where_no_hit_comes_the_person_is_told_what_the_trigger_has_seen(tmp_path):
    class Patient(Display):
        seen = ()

        def show(self, snapshot):
            self.seen = snapshot.messages

        def commands(self):
            return ["stop"] if self.seen else []

    display = Patient()
    measure(hammer_rig(tmp_path, (TRIGGER, "[trigger]\nlevel = 400")), tmp_path / "out.h5", display)
    assert re.match(r"no hit within 30 s: 'hammer' reached 1\d\d N, trigger.level is 400", display.seen[0])


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
    slower = hammer_rig(tmp_path, ("rate = 2048", 'kind = "replay"\nsession = "whole.h5"\nrate = 1024'))
    with pytest.raises(ConfigError, match=r"device\.rate: the replayed run has 2048 Hz, not 1024 Hz"):
        measure(slower, tmp_path / "none.h5")


def test_a_replay_plays_no_generator_and_records_what_there_was(tmp_path):
    measure(shaker_rig(tmp_path, ("levels = [0.5, 2.0]", "levels = [2.0]")), tmp_path / "whole.h5")
    replay = ("rate = 1024", 'kind = "replay"\nsession = "whole.h5"\nrate = 1024')
    with pytest.raises(ConfigError, match=r"excitation\.kind: a replay has no generator to play 'multisine'"):
        measure(shaker_rig(tmp_path, replay), tmp_path / "none.h5")
    again = shaker_rig(tmp_path, replay, ('kind = "multisine"', 'kind = "none"\nduration = 4.0'))
    assert measure(again, tmp_path / "again.h5").complete
    with open_session(tmp_path / "whole.h5") as one, open_session(tmp_path / "again.h5") as two:
        played = two.runs[0].raw()
        np.testing.assert_array_equal(played, one.runs[0].raw(0, played.shape[1]))
        assert played.shape[1] >= 4 * 1024


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


def test_a_device_that_is_not_there_leaves_no_session_that_would_refuse_the_rig_put_right(tmp_path, monkeypatch):
    def gone(rig, item, attempt=0):
        raise DeviceNotFoundError("no audio device is called 'USB'")

    out, more = tmp_path / "out.h5", tmp_path / "more.h5"
    wrong, more_hits = hammer_rig(tmp_path, ("seed = 3", "seed = 2")), hammer_rig(tmp_path, ("hits = 3", "hits = 4"))
    with monkeypatch.context() as patch:
        patch.setattr("sessions.bench.devices", gone)
        with pytest.raises(DeviceNotFoundError):
            measure(wrong, out)
    assert not out.exists()
    rig = hammer_rig(tmp_path)
    assert measure(rig, out).complete
    with monkeypatch.context() as patch:
        patch.setattr("sessions.bench.devices", gone)
        with pytest.raises(DeviceNotFoundError):
            measure(more_hits, more)
        with pytest.raises(ConfigError, match="begun with another"):
            measure(more_hits, out)
    with open_session(out) as session:
        assert len(session.runs) == 2
