"""labnnum init: files that the readers accept, and that a simulated bench can measure as they are."""

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.errors import ConfigError, FileError
from labnnum.response import frf
from labnnum.structures.examples import EXAMPLES
from sessions.bench import measure
from sessions.cli import app
from sessions.devices import model_text
from sessions.model import read_model
from sessions.rig import read_rig
from sessions.starters import RIGS, STRUCTURES, write_starter

KINDS = [(rig, structure) for rig in RIGS for structure in STRUCTURES]


@pytest.mark.parametrize(("rig", "structure"), KINDS)
def test_the_readers_accept_them(tmp_path, rig, structure):
    write_starter(tmp_path, rig, structure)
    bench, model = read_rig(tmp_path / "rig.toml"), read_model(tmp_path / "model.toml")
    assert model.structure.parameters
    assert model.bands
    driven = [f"{p}" for p in bench.toml.plan.points]
    places = [c.dof for c in bench.channels if c.dof and c.role != "base"]
    for place in [*driven, *places]:
        node, _, direction = place.partition(":")
        model.structure.require_dof(f"{node}:{direction.lstrip('-')}")
    for line in (tmp_path / "rig.toml").read_text(encoding="utf-8").splitlines():
        assert len(line) < 140


@pytest.mark.parametrize("structure", STRUCTURES)
def test_every_band_holds_what_it_is_for(tmp_path, structure):
    """The FRF moves in each band when the parameters move within their prior."""
    write_starter(tmp_path, "simulated", structure)
    model, rig = read_model(tmp_path / "model.toml"), read_rig(tmp_path / "rig.toml")
    inputs = [c for c in rig.channels if c.role in ("reference", "base")]
    outputs = [c for c in rig.channels if c.role == "response"]
    theta = model.structure.nominal
    for band in model.bands:
        lines = np.linspace(band.low, band.high, 60)
        nominal = frf(model.structure, theta, lines, outputs, inputs)
        moved = [
            frf(model.structure, theta + step, lines, outputs, inputs)
            for step in np.diag([p.spread for p in model.structure.parameters])
        ]
        assert max(np.abs(m / nominal - 1).max() for m in moved) > 0.1


def test_the_beam_is_the_dissertation_s(tmp_path):
    write_starter(tmp_path, "simulated", "beam")
    model, example = read_model(tmp_path / "model.toml"), EXAMPLES["beam"]()
    assert model.structure.parameters == example.structure.parameters
    lines = np.linspace(5.0, 700.0, 300)
    ours = frf(model.structure, model.structure.nominal, lines, example.outputs, example.inputs)
    theirs = frf(example.structure, example.structure.nominal, lines, example.outputs, example.inputs)
    np.testing.assert_allclose(ours, theirs, rtol=1e-3)
    for mine, other in zip(model.bands, example.bands, strict=True):
        assert (mine.real, mine.imag) == (other.real, other.imag)
        np.testing.assert_allclose((mine.low, mine.high), (other.low, other.high), atol=1e-3)


@pytest.mark.parametrize(
    ("rig", "structure"), [("simulated", "chain"), ("simulated-hammer", "frame"), ("simulated", "matrices")]
)
def test_a_simulated_bench_measures_them(tmp_path, rig, structure):
    write_starter(tmp_path, rig, structure)
    bench = read_rig(tmp_path / "rig.toml")
    outcome = measure(bench, tmp_path / "first.h5", model_text=model_text(bench))
    assert outcome.complete
    bands = read_model(tmp_path / "model.toml").bands
    for found in outcome.frfs.values():
        if found.coherence is not None:
            inside = [found.lines(b.low, b.high).coherence for b in bands]
            assert np.mean(np.concatenate(inside, axis=-1)) > 0.9


def test_nothing_is_written_over(tmp_path):
    (tmp_path / "model.toml").write_text("mine", encoding="utf-8")
    with pytest.raises(FileError, match=r"model\.toml: exists already"):
        write_starter(tmp_path, "simulated", "beam")
    assert not (tmp_path / "rig.toml").exists()
    assert (tmp_path / "model.toml").read_text(encoding="utf-8") == "mine"


def test_an_unknown_kind_is_named_with_what_there_is(tmp_path):
    with pytest.raises(ConfigError, match="--rig 'hamer': expected one of simulated, simulated-hammer, shaker, hammer"):
        write_starter(tmp_path, "hamer", "beam")
    with pytest.raises(ConfigError, match="--structure 'plate'"):
        write_starter(tmp_path, "hammer", "plate")


def test_the_command_says_what_comes_next(tmp_path):
    done = CliRunner().invoke(app, ["init", str(tmp_path / "new"), "--structure", "chain"])
    assert done.exit_code == 0
    assert "labnnum measure" in done.stdout
    assert (tmp_path / "new" / "rig.toml").is_file()
