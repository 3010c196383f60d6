"""The dissertation's structures with one effect concealed: their figures, that effects show, and the verdicts' way."""

import json

import numpy as np
import pytest

from labnnum.errors import ConfigError
from sessions.prove import dissertation
from sessions.prove.truth.bench import first_modes
from sessions.prove.truth.dissertation import ACCELEROMETER, EFFECTS
from sessions.prove.truth.respond import transfer
from sessions.prove.truth.state import plant

BY_NAME = {e.name: e for e in EFFECTS}


def test_the_beam_resonates_within_the_dissertations_bands():
    bench = BY_NAME["beam-sound"].state().bench
    bands = np.array([[86.4, 141], [636, 699], [1932, 2058], [3770, 4131]])
    found = 2 * np.pi * first_modes(bench.coarse, 4)
    assert bench.coarse.active.size == 12
    assert np.all((bands[:, 0] < found) & (found < bands[:, 1]))
    assert dict(bench.coarse.lumps)[bench.coarse.dof("3", 1)] == ACCELEROMETER[0]


def test_the_frame_has_as_many_degrees_of_freedom_as_the_dissertations():
    bench = BY_NAME["frame-sound"].state().bench
    assert bench.coarse.active.size == 96
    assert 2 * np.pi * first_modes(bench.coarse, 1)[0] == pytest.approx(65, rel=0.1)


@pytest.mark.parametrize("effect", [e for e in EFFECTS if not e.name.startswith(("beam-sound", "frame-sound"))])
def test_every_effect_changes_the_response_and_is_told(effect):
    state = effect.state()
    sound = next(e for e in EFFECTS if e.make.__name__ == "_nothing" and e.sensors == effect.sensors)
    twin = type(effect)("twin", effect.structure, effect.sensors, sound.make, effect.seed).state()
    s = 2j * np.pi * np.linspace(*state.bench.band, 200)
    with_it, without = transfer(plant(state), s), transfer(plant(twin), s)
    assert np.linalg.norm(with_it - without) > 0.02 * np.linalg.norm(without)
    assert len(state.faults) == 1
    assert effect.make.__doc__


def test_a_right_answer_is_called_right_and_silence_wrong(tmp_path, monkeypatch):
    def clever(recordings, model, out):
        fault = BY_NAME[out.name].state().faults[0]
        mechanism = {"id": fault.mechanism, "parameters": {k: v | {"std": 1.0} for k, v in fault.parameters.items()}}
        said = {
            "verdict": "missing-physics",
            "place": fault.place,
            "mechanism": mechanism,
            "further": [],
            "located": [],
        }
        (out / "diagnosis.json").write_text(json.dumps(said))

    def silent(recordings, model, out):
        assert model.is_file()
        assert all(path.is_file() for path in recordings)
        (out / "diagnosis.json").write_text(json.dumps({"verdict": "consistent", "place": None, "mechanism": None}))

    for tool, right in ((clever, True), (silent, False)):
        monkeypatch.setattr(dissertation, "load", lambda _, tool=tool: tool)
        (row,) = dissertation.run(tmp_path / tool.__name__, names=["beam-clamp"])
        assert row["right"] is right
        assert row["visibility"] > 3
    (row,) = dissertation.run(tmp_path, names=["frame-sound"])
    assert row["right"]
    monkeypatch.setattr(dissertation, "load", lambda _: None)
    assert dissertation.run(tmp_path, names=["frame-sound"]) == [row]
    assert json.loads((tmp_path / "dissertation.json").read_text())[0]["case"] == "frame-sound"


def test_a_case_that_is_none_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="beam-sound"):
        dissertation.run(tmp_path, names=["plate"])
