"""The page beside an identified model holds the diagram, the modes with their deviations and what the model misses."""

import re
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.errors import FileError
from labnnum.frf import Frf
from labnnum.identification import identify, reciprocal
from labnnum.identification_residues import fit_residues
from labnnum.recording import Channel
from labnnum.response import frf as model_frf
from labnnum.response import modes
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from labnnum.structures.quantities import Damping
from sessions.cli import app
from sessions.identify import identify_files
from sessions.report.identify import KINDS, IdentifiedPage, write_identified

OUTPUTS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x" if i < 3 else "-x") for i in (1, 2, 3))
FORCE = (Channel("f", "force", "reference", "1", "x"),)
LINES = np.linspace(2.0, 12.0, 300)
LINKS = (Link("1", "ground", 2000.0), Link("1", "2", 1500.0), Link("2", "3", 1800.0), Link("3", "ground", 900.0))
CHAIN = Chain({"1": 1.0, "2": 1.2, "3": 0.9}, LINKS, damping=Damping("modal", ratio=(0.01, 0.015, 0.02)))


def measured(outputs=OUTPUTS, inputs=FORCE, noise=0.005):
    value = model_frf(CHAIN, CHAIN.nominal, LINES, outputs, inputs)
    normal = np.random.default_rng(3).standard_normal((2, *value.shape)) / np.sqrt(2)
    size = noise * np.sqrt(np.mean(np.abs(value) ** 2, axis=-1, keepdims=True)) * np.ones(value.shape)
    return Frf(LINES, value + size * (normal[0] + 1j * normal[1]), outputs, inputs, variance=size**2)


def page_of(frf, **more):
    found = identify(frf, 24)
    free = fit_residues(frf, np.column_stack([found.frequency, found.damping_ratio]))
    return IdentifiedPage("base", "low", frf, found, free, 24, **more)


def test_the_page_holds_what_was_found(tmp_path):
    page = page_of(measured(), remarks=["a remark & more"])
    text = write_identified(tmp_path / "base.html", page).read_text(encoding="utf-8")
    assert "labnnum report</title>" in text
    for anchor in ("modes", "stabilisation", "frf", "shapes", "settings"):
        assert text.count(f'<section id="{anchor}">') == 1
    assert text.count("<svg") == 1 + len(OUTPUTS) + 2
    assert not re.search(r'\b(src|href)="(?!#|data:)', text)  # nothing is loaded from elsewhere
    assert "a remark &amp; more" in text
    for f, z in zip(page.found.frequency, page.found.damping_ratio, strict=True):
        assert f"{f:.6g} Hz" in text
        assert f"{100 * z:.4g} %" in text
    assert len(re.findall(r"\d ± \d", text)) >= 2 * page.found.frequency.size


def test_every_pole_of_the_diagram_is_drawn_as_one_kind():
    d = page_of(measured()).found.stabilisation
    kinds = np.array([chosen(d) for *_, chosen in KINDS])
    np.testing.assert_array_equal(kinds.sum(axis=0), 1)
    np.testing.assert_array_equal(kinds[-1], d.stable)


def test_what_the_page_draws_of_the_model_are_its_frfs():
    """Sensors that point the other way too."""
    page = page_of(measured(noise=1e-4))
    structure = page.found.structure
    np.testing.assert_allclose(page.fitted, model_frf(structure, [], LINES, OUTPUTS, FORCE)[:, 0], rtol=1e-6)
    assert np.linalg.norm(page.fitted - page.frf.value[:, 0]) < 0.01 * np.linalg.norm(page.frf.value)
    exact = modes(CHAIN, CHAIN.nominal).shape
    shapes = page.found.shapes
    np.testing.assert_allclose(shapes * np.sign(shapes[0]), exact * np.sign(exact[0]), atol=0.02)


def test_a_roving_hammer_gives_the_modes_of_a_roving_sensor():
    hammers = tuple(Channel(f"h{i}", "force", "reference", str(i), "x") for i in (1, 2, 3))
    turned = reciprocal(measured((replace(OUTPUTS[0], node="2"),), hammers, 0.0))
    assert [c.dof for c in turned.outputs] == ["1:x", "2:x", "3:x"]
    assert [c.dof for c in turned.inputs] == ["2:x"]
    exact = model_frf(CHAIN, CHAIN.nominal, LINES, turned.outputs, turned.inputs)
    np.testing.assert_allclose(turned.value, exact, rtol=1e-9)
    found = identify(turned, 24)
    np.testing.assert_allclose(found.frequency, modes(CHAIN, CHAIN.nominal).frequency, rtol=1e-4)


@pytest.fixture
def given(tmp_path):
    """FRFs as a file of another program, and its channels.toml."""
    frf = measured()
    np.savez(tmp_path / "h.npz", f=LINES, H=frf.value[:, 0])
    lines = ["[frf]", 'frequency = "f"', 'value = "H"']
    for c, role in [*((c, "response") for c in OUTPUTS), (FORCE[0], "reference")]:
        lines += ["[[channel]]", f'name = "{c.name}"', f'quantity = "{c.quantity}"', f'unit = "{c.unit}"']
        lines += [f'role = "{role}"', f'node = "{c.node}"', f'direction = "{c.direction}"']
    (tmp_path / "channels.toml").write_text("\n".join(lines))
    return [str(tmp_path / "h.npz"), "--channels", str(tmp_path / "channels.toml"), "-o", str(tmp_path / "base.toml")]


def test_the_command_writes_the_page_unless_told_not_to(tmp_path, given):
    quiet = CliRunner().invoke(app, ["identify", *given, "--no-report"])
    assert quiet.exit_code == 0, quiet.output
    assert not (tmp_path / "base.html").exists()
    model = (tmp_path / "base.toml").read_text()
    shown = CliRunner().invoke(app, ["identify", *given])
    assert shown.exit_code == 0, shown.output
    assert "report:" in shown.output
    assert (tmp_path / "base.html").is_file()
    assert (tmp_path / "base.toml").read_text() == model


def test_a_page_of_something_else_is_not_written_over(tmp_path, given):
    (tmp_path / "base.html").write_text("mine")
    with pytest.raises(FileError, match=r"base\.html: exists already"):
        identify_files(given[:1], tmp_path / "base.toml", given[2], report=True)
    assert (tmp_path / "base.html").read_text() == "mine"
    assert not (tmp_path / "base.toml").exists()


def test_deviations_are_told_to_scripts(tmp_path, given):
    said = identify_files(given[:1], tmp_path / "base.toml", given[2])
    exact = modes(CHAIN, CHAIN.nominal)
    assert said["report"] is None
    for pole, f, z in zip(said["poles"], exact.frequency, exact.damping_ratio, strict=True):
        assert abs(pole["frequency"] - f) < 5 * pole["frequency_std"]
        assert abs(pole["damping_ratio"] - z) < 5 * pole["damping_ratio_std"]
        assert pole["frequency_std"] < 1e-3 * f
    assert said["error_complex"] <= said["error"]
