"""Proposed plans keep their own promises, and run as they stand."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.errors import ModelError
from labnnum.recording import Channel
from labnnum.response import frf, modes
from labnnum.structures import Beam
from labnnum.structures.chain import Chain, Link
from labnnum.structures.section import Section
from sessions.bench import measure
from sessions.cli import app
from sessions.plan import LINES, Wishes, propose
from sessions.rig import parse_rig

from .rigs import two_masses

CHAIN = Chain(masses={"1": 2.0, "2": 1.0}, links=(Link("1", "ground", 8e5, 80.0), Link("1", "2", 5e5, 50.0)))
CHANNELS = """
[[channel]]
name = "force"
role = "reference"
unit = "N"
sensitivity = 0.05
{place}
[[channel]]
name = "a2"
unit = "m/s^2"
sensitivity = 0.05
node = "2"
direction = "x"
[generator]
max_volts = 8.0
[simulated]
gain = 5.0
input_noise = 0.0005
[simulated.hammer]
tip = "rubber"
interval = {interval}
"""


@pytest.mark.parametrize("kind", sorted(LINES))
@pytest.mark.parametrize("purpose", ["update", "diagnosis"])
def test_promises(kind, purpose):
    made = propose(CHAIN, CHAIN.nominal, (), Wishes(kind, purpose))
    e = made.tables["excitation"]
    found = modes(CHAIN, CHAIN.nominal)
    assert e["low"] < found.frequency[0]
    assert e["high"] > found.frequency[1]
    rate = made.tables["device"]["rate"]
    assert rate >= 2.56 * e["high"] * 0.999
    width = float(np.min(2 * found.frequency * found.damping_ratio))
    block = e.get("period") or made.tables.get("processing", {}).get("segment")
    if block:
        assert width * block / rate >= LINES[kind] * 0.999
    if kind == "stepped sine":
        law = np.geomspace if e["spacing"] == "log" else np.linspace
        tones = law(e["low"], e["high"], e["lines"])
        for f, z in zip(found.frequency, found.damping_ratio, strict=True):
            assert np.max(np.diff(tones)[np.abs(tones[1:] - f) < z * f]) <= 2 * z * f / LINES[kind] * 1.05
    if purpose == "diagnosis" and kind != "hammer":
        assert len(e["levels"]) == 3
        np.testing.assert_allclose(np.diff(20 * np.log10(e["levels"])), 10, atol=0.1)
    assert all(made.reasons)
    assert made.seconds > 0


def test_the_first_mode_counts_however_fine_the_mesh():
    """Of sixty elements the highest frequency is over ten thousand times the first."""
    beam = Beam(0.4, Section(EI=11.2, rhoA=0.324), 60, supports_at={"1": "clamped"})
    found = modes(beam, beam.nominal).frequency
    assert found[-1] > 1e4 * found[0]
    assert propose(beam, beam.nominal, (), Wishes()).tables["excitation"]["low"] < found[0]


def test_a_free_body_without_elastic_modes_is_told():
    lone = Chain(masses={"1": 2.0}, links=())
    with pytest.raises(ModelError, match="only moves as a rigid body"):
        propose(lone, lone.nominal, (), Wishes())


def test_the_highest_level_keeps_the_sensors_in_range():
    free = propose(CHAIN, CHAIN.nominal, (), Wishes(top=10.0)).tables["excitation"]["levels"][0]
    held = propose(CHAIN, CHAIN.nominal, (), Wishes(top=10.0, limit=50.0)).tables["excitation"]
    assert free == 10.0
    level = held["levels"][0]
    lines = np.linspace(held["low"], held["high"], 20001)
    tip, push = Channel("a", node="2", direction="x"), Channel("f", "force", "reference", "2", "x")
    rms = level * np.sqrt(np.mean(np.abs(frf(CHAIN, [], lines, [tip], [push])) ** 2))
    assert 4.5 * rms == pytest.approx(50.0, rel=0.02)


@pytest.mark.parametrize("kind", ["multisine", "random", "hammer"])
def test_a_proposal_runs_and_reaches_its_random_error(tmp_path, kind):
    wishes = Wishes(kind, error=0.05, top=50.0 if kind == "hammer" else 1.0, rate=1024.0, high=300.0)
    made = propose(CHAIN, CHAIN.nominal, (), wishes)
    place = "" if kind == "hammer" else 'node = "1"\ndirection = "x"'
    text = made.toml + CHANNELS.format(place=place, interval=2.0)
    text = text.replace("[plan]", '[plan]\npoints = ["1:x"]')
    (tmp_path / "model.toml").write_text(two_masses())
    outcome = measure(parse_rig(text, tmp_path / "rig.toml"), tmp_path / "out.h5")
    assert outcome.complete
    found = next(iter(outcome.frfs.values()))
    peak = np.argmax(np.abs(found.value[0, 0]))
    exact = frf(CHAIN, [], [found.frequency[peak]], found.outputs, found.inputs)[0, 0, 0]
    assert abs(found.value[0, 0, peak] / exact - 1) < 0.1


def test_a_band_without_modes_is_said():
    with pytest.raises(ModelError, match="no mode of the model lies between"):
        propose(CHAIN, CHAIN.nominal, (), Wishes(low=300.0, high=400.0))


def test_tones_resolve_narrow_modes_however_many_that_takes():
    light = replace(CHAIN, links=tuple(replace(link, damping=0.02 * link.damping) for link in CHAIN.links))
    e = propose(light, light.nominal, (), Wishes("stepped sine")).tables["excitation"]
    found = modes(light, light.nominal)
    tones = (np.geomspace if e["spacing"] == "log" else np.linspace)(e["low"], e["high"], e["lines"])
    for f, z in zip(found.frequency, found.damping_ratio, strict=True):
        assert np.count_nonzero(np.abs(tones - f) <= z * f) >= 2


def test_a_structure_driven_by_its_base_is_not_hammered():
    with pytest.raises(ModelError, match=r"structure.base is 'x': .* leave out structure.base"):
        propose(replace(CHAIN, base="x"), CHAIN.nominal, (), Wishes("hammer"))


def test_command(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(two_masses())
    result = CliRunner().invoke(app, ["plan", str(path), "--excitation", "stepped-sine", "--json"])
    assert result.exit_code == 0
    told = json.loads(result.stdout)
    assert told["tables"]["excitation"]["kind"] == "stepped sine"
    assert len(told["modes"]) == 2
    text = CliRunner().invoke(app, ["plan", str(path), "--for", "diagnosis"]).stdout
    assert "detection = 4" in text
    bad = CliRunner().invoke(app, ["plan", str(path), "--excitation", "bang"])
    assert "expected one of multisine" in str(bad.exception)
