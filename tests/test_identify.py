"""Modal identification: exact on modes, robust to noise, and as a command."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.errors import EstimationError
from labnnum.frf import Frf
from labnnum.identification import identify, receptance_of
from labnnum.recording import Channel
from labnnum.response import frf as model_frf
from labnnum.stabilisation import lscf
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from labnnum.structures.modal import ModalStructure, Mode
from labnnum.structures.quantities import Damping
from sessions.cli import app
from sessions.model import read_model

OUTPUTS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in (1, 2, 3))
FORCE = (Channel("f", "force", "reference", "1", "x"),)
LINES = np.linspace(2.0, 12.0, 400)


def chain():
    links = (Link("1", "ground", 2000.0), Link("1", "2", 1500.0), Link("2", "3", 1800.0), Link("3", "ground", 900.0))
    return Chain({"1": 1.0, "2": 1.2, "3": 0.9}, links, damping=Damping("modal", ratio=(0.01, 0.015, 0.02)))


def measured(noise=0.0, seed=0):
    structure = chain()
    value = model_frf(structure, structure.nominal, LINES, OUTPUTS, FORCE)
    rng = np.random.default_rng(seed)
    size = np.abs(value)
    error = (rng.standard_normal(value.shape) + 1j * rng.standard_normal(value.shape)) / np.sqrt(2)
    variance = (noise * size) ** 2 + 1e-18
    return Frf(LINES, value + noise * size * error, OUTPUTS, FORCE, variance=variance)


def exact():
    from labnnum.response import modes

    found = modes(chain(), chain().nominal)
    return found.frequency, found.damping_ratio


def test_clean_frfs_give_the_modes_exactly():
    found = identify(measured(), 24)
    frequency, damping = exact()
    np.testing.assert_allclose(found.frequency, frequency, rtol=1e-5)
    np.testing.assert_allclose(found.damping_ratio, damping, rtol=1e-3)
    assert found.error < 1e-3


def test_the_model_answers_like_the_measured_one_between_all_its_places():
    found = identify(measured(), 24)
    at = Channel("f3", "force", "reference", "3", "x")
    truth = model_frf(chain(), chain().nominal, LINES, OUTPUTS, (at,))
    made = model_frf(found.structure, found.structure.nominal, LINES, OUTPUTS, (at,))
    assert np.linalg.norm(made - truth) < 0.01 * np.linalg.norm(truth)


def test_noise_of_two_percent_leaves_the_frequencies():
    frequency, damping = exact()
    for seed in range(3):
        found = identify(measured(0.02, seed), 30)
        assert found.frequency.size == 3
        np.testing.assert_allclose(found.frequency, frequency, rtol=1e-3)
        np.testing.assert_allclose(found.damping_ratio, damping, rtol=0.05)


def measured_beside(at_force, at_sensor, noise=0.01, seed=1):
    """FRFs of three modes of which the second moves the driven place hardly, and the sensor there by something else."""
    shapes = ((1.0, 1.0, 0.8, 0.6), (at_force, at_sensor, 1.0, -0.9), (0.7, 0.7, -0.9, 0.5))
    named = [dict(zip(("0:x", "1:x", "2:x", "3:x"), row, strict=True)) for row in shapes]
    structure = ModalStructure(tuple(map(Mode, (3.0, 6.0, 9.0), (0.01, 0.012, 0.015), named)))
    value = model_frf(structure, [], LINES, OUTPUTS, (Channel("f", "force", "reference", "0", "x"),))
    normal = np.random.default_rng(seed).standard_normal((2, *value.shape)) / np.sqrt(2)
    scatter = noise * np.abs(value)
    return Frf(LINES, value + scatter * (normal[0] + 1j * normal[1]), OUTPUTS, FORCE, variance=scatter**2 + 1e-18)


@pytest.mark.parametrize(("at_force", "at_sensor"), [(0.05, -0.02), (0.1, -0.1), (0.1, 0.0), (0.05, 0.05)])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_what_is_said_to_be_missed_is_what_the_structure_misses(at_force, at_sensor, noise):
    frf = measured_beside(at_force, at_sensor, noise)
    found = identify(frf, 24)
    made = Frf(LINES, model_frf(found.structure, [], LINES, OUTPUTS, FORCE), OUTPUTS, FORCE)
    h, answered = receptance_of(frf), receptance_of(made)
    missed = np.sum(np.abs(answered - h) ** 2, axis=1) / np.sum(np.abs(h) ** 2, axis=1)
    assert found.error == pytest.approx(np.sqrt(missed.mean()), rel=1e-6, abs=1e-9)
    np.testing.assert_allclose(found.fitted, answered, rtol=1e-6, atol=1e-9 * np.abs(h).max())
    assert found.error < 1.1 * noise + 0.003


def test_a_mode_nearly_nodal_at_the_drive_is_told_and_no_larger_than_the_scatter_allows():
    assert identify(measured_beside(0.3, 0.3), 24).nodal.size == 0
    found = identify(measured_beside(0.05, -0.02), 24)
    assert found.nodal == pytest.approx([6.0], rel=1e-3)
    (mode,) = (m for m in found.structure.modes if abs(m.frequency - 6) < 0.1)
    assert mode.shape["1:x"] * mode.shape["2:x"] == pytest.approx(0.05, rel=0.05)
    assert abs(mode.shape["2:x"]) < 10


def test_a_mode_nearly_nodal_at_the_only_sensor_has_a_size():
    """No other sensor tells how large it is."""
    frf = measured_beside(0.05, -0.02, 1e-3)
    found = identify(replace(frf, value=frf.value[:1], variance=frf.variance[:1], outputs=frf.outputs[:1]), 24)
    assert all(np.isfinite(v) for m in found.structure.modes for v in m.shape.values())
    assert found.error < 0.02


@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_modes_beside_the_band_stand_only_for_what_is_there(noise):
    """Of a structure with three modes none is left over; of the same lines without the first, one below the band is."""
    low = np.linspace(0.5, 12.0, 460)
    structure = chain()
    for lines, beside in ((low, 0), (low[low > 1.3 * exact()[0][0]], 1)):
        for seed in range(4):
            value = model_frf(structure, structure.nominal, lines, OUTPUTS, FORCE)
            normal = np.random.default_rng(seed).standard_normal((2, *value.shape)) / np.sqrt(2)
            size = noise * np.sqrt(np.mean(np.abs(value) ** 2))
            measured = value + size * (normal[0] + 1j * normal[1])
            variance = np.full(value.shape, size**2)
            found = identify(Frf(lines, measured, OUTPUTS, FORCE, variance=variance), 24)
            below = [m.frequency for m in found.structure.modes if m.frequency < lines[0]]
            assert len(below) == beside
            assert beside or len(found.structure.modes) == 3


def two_close(apart, noise, seed):
    """Modes at 3, 6 and 9 Hz, and one a share of a half-power bandwidth above the second; variance not stated."""
    shapes = ((1.0, 0.8, 0.6), (0.9, 1.0, -0.9), (0.8, -0.7, 0.9), (0.7, -0.9, 0.5))
    named = [dict(zip(("1:x", "2:x", "3:x"), row, strict=True)) for row in shapes]
    frequency = (3.0, 6.0, 6.0 * (1 + 2 * 0.006 * apart), 9.0)
    lines = np.linspace(2.0, 12.0, 1600)
    structure = ModalStructure(tuple(map(Mode, frequency, (0.006,) * 4, named)))
    value = model_frf(structure, [], lines, OUTPUTS, FORCE)
    normal = np.random.default_rng(seed).standard_normal((2, *value.shape)) / np.sqrt(2)
    size = noise * np.sqrt(np.mean(np.abs(value) ** 2, axis=-1, keepdims=True))
    return Frf(lines, value + size * (normal[0] + 1j * normal[1]), OUTPUTS, FORCE), frequency


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_two_modes_within_half_a_bandwidth_are_told_apart(noise, seed):
    frf, frequency = two_close(0.5, noise, seed)
    found = identify(frf, 40)
    assert found.frequency.size == 4
    np.testing.assert_allclose(found.frequency, frequency, rtol=1e-3)
    assert identify(frf, 40, modes=3).frequency.size == 3


def test_a_mode_that_moved_from_record_to_record_is_one():
    """Rows of a roving hammer, whose structure was a tenth of a bandwidth higher at one of them."""
    frf, _ = two_close(0.0, 1e-3, 0)
    value = frf.value.copy()
    moved = np.interp(frf.frequency / (1 + 0.2 * 0.006), frf.frequency, np.arange(frf.frequency.size))
    value[1, 0] = np.interp(moved, np.arange(moved.size), frf.value[1, 0].real) + 1j * np.interp(
        moved, np.arange(moved.size), frf.value[1, 0].imag
    )
    assert identify(replace(frf, value=value), 40).frequency.size == 3


def test_lscf_of_a_low_order_comes_near_the_poles():
    value = receptance_of(measured())
    poles = np.array(lscf(2 * np.pi * LINES, value, 12))
    for f in exact()[0]:
        assert np.min(np.abs(poles[:, 0] - f)) < 5e-3 * f


def test_a_drive_point_is_asked_for():
    frf = measured()
    other = Frf(LINES, frf.value, OUTPUTS, (Channel("f", "force", "reference", "9", "x"),), variance=frf.variance)
    with pytest.raises(EstimationError, match="9:x"):
        identify(other)


def typed(tmp_path, frf):
    """What the command prints, as text and as JSON, of FRFs in a file; and the model that it writes."""
    arrays = {"f": LINES, "H": frf.value[:, 0]}
    np.savez(tmp_path / "h.npz", **arrays)
    channels = ["[frf]", 'frequency = "f"', 'value = "H"']
    for c, role in [*((c, "response") for c in OUTPUTS), (FORCE[0], "reference")]:
        quantity, unit = (c.quantity, c.unit)
        channels += ["[[channel]]", f'name = "{c.name}"', f'quantity = "{quantity}"', f'unit = "{unit}"']
        channels += [f'role = "{role}"', f'node = "{c.node}"', 'direction = "x"']
    (tmp_path / "channels.toml").write_text("\n".join(channels))
    out = tmp_path / "base.toml"
    given = [str(tmp_path / "h.npz"), "--channels", str(tmp_path / "channels.toml"), "-o", str(out)]
    shown = [CliRunner().invoke(app, ["identify", *given, *more]) for more in ([], ["--json"])]
    assert [r.exit_code for r in shown] == [0, 0], shown[0].output
    return shown[0].output, json.loads(shown[1].stdout), out


def test_the_command_tells_which_modes_are_nodal_at_the_drive(tmp_path):
    shown, said, _ = typed(tmp_path, measured_beside(0.05, -0.02))
    assert said["nodal_at_drive"] == pytest.approx([6.0], rel=1e-3)
    assert "the mode at 6 Hz hardly moves the driven place" in " ".join(shown.split())


def test_the_command_writes_a_model(tmp_path):
    _, said, out = typed(tmp_path, measured())
    assert said["nodal_at_drive"] == []
    np.testing.assert_allclose([m["frequency"] for m in said["modes"]], exact()[0], rtol=1e-3)
    model = read_model(out)
    assert set(model.structure.dofs) == {"1:x", "2:x", "3:x"}
    assert ("1", "3") in [tuple(p) for p in model.places.elements]
