"""The benches that `labnnum init` writes, measured and diagnosed as a user does: what is sound is told to be sound."""

import json

import pytest
from typer.testing import CliRunner

from sessions.cli import app


def said(*words):
    result = CliRunner().invoke(app, [str(w) for w in words])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize(
    ("rig", "structure", "within"), [("simulated", "beam", 0.01), ("simulated-hammer", "matrices", 0.01)]
)
def test_a_sound_structure_on_a_simulated_bench_is_sound(tmp_path, rig, structure, within):
    said("init", tmp_path / "first", "--rig", rig, "--structure", structure)
    model, run = tmp_path / "first" / "model.toml", tmp_path / "run.h5"
    said("measure", tmp_path / "first" / "rig.toml", "-o", run)
    said("diagnose", run, "--model", model, "-o", tmp_path / "out")
    told = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert told["verdict"] in ("consistent", "parameters")
    assert told["fit"]["base"]["held_out"] < within
    said("diagnose", run, "--model", tmp_path / "out" / "extended.toml", "-o", tmp_path / "again")  # a model like any
    assert json.loads((tmp_path / "again" / "diagnosis.json").read_text(encoding="utf-8"))["verdict"] == "consistent"
