"""What a moving base pushes a structure by: the mass of elements at the supports is part of it."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.mechanisms import extend
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.response import frf, frf_sensitivity
from labnnum.simulation import Simulation
from labnnum.structures import Beam, Frame, MatrixStructure
from labnnum.structures.beam import Lump
from labnnum.structures.frame import Member, Profile
from labnnum.structures.quantities import modal, proportional
from labnnum.structures.section import Section
from labnnum.system import system
from labnnum.updating.batch import FrfBatch

EI, RHO_A, L = 120.0, 2.5, 0.8
BASE = Channel("base", "acceleration", "base", "1", "z")


def cantilever(n, **more):
    return Beam(L, Section(EI=EI, rhoA=RHO_A), n, supports_at={"1": "clamped"}, base="z", **more)


def column(n):
    """The same cantilever as a frame along x."""
    profile = Profile(E=7e10, rho=2700.0, A=RHO_A / 2700.0, Iy=EI / 7e10, Iz=EI / 7e10, J=1e-9)
    nodes = {str(i + 1): (L * i / n, 0.0, 0.0) for i in range(n + 1)}
    members = tuple(Member(str(i + 1), str(i + 2), "p") for i in range(n))
    held = {"1": ("x", "y", "z", "rx", "ry", "rz")}
    return Frame(nodes, {"p": profile}, members, fixed=held, base="z", damping=modal(0.01))


def in_matrices(n):
    """The same from matrices, the clamped node's rows among them."""
    free = replace(cantilever(n), supports_at={})
    m = free.matrices(np.zeros(0))
    return MatrixStructure(m.M, m.K, free.dofs, base="z", clamped=("1",), damping=modal(0.01))


@pytest.mark.parametrize("made", [cantilever, column, in_matrices])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_an_even_acceleration_bends_a_cantilever_as_its_weight_does(made, n):
    """At the nodes of cubic elements the static deflection is exact: w L^4 / (8 EI) at the tip, whatever the mesh."""
    s = made(n)
    bent = np.linalg.solve(s.matrices(np.zeros(0)).K, s.base_load(np.zeros(0)))
    tip = s.participation(f"{n + 1}:z", np.zeros(0)) @ bent
    assert tip == pytest.approx(RHO_A * L**4 / (8 * EI), rel=1e-9)


def test_a_coarse_beam_follows_a_fine_one():
    """The peaks of six elements and of sixty are as high, each at its own frequency."""
    tip = Channel("a", "acceleration", "response", "7", "z")
    coarse, fine = cantilever(6, damping=modal(0.01)), cantilever(60, damping=modal(0.01))
    at = np.linspace(1.0, 260.0, 60_000)
    low = np.abs(frf(coarse, [], at, [tip], [BASE])[0, 0])
    high = np.abs(frf(fine, [], at, [replace(tip, node="61")], [BASE])[0, 0])
    for mode, within in ((6.06, 0.001), (37.96, 0.002), (106.3, 0.01), (208.3, 0.02)):
        near = np.abs(at / mode - 1) < 0.08
        assert low[near].max() == pytest.approx(high[near].max(), rel=within)


def varied():
    parameters = (
        Parameter("tip", 0.05, 0.02, 0.1, "kg"),
        Parameter("rhoA", RHO_A, 2.0, 3.0, "kg/m"),
        Parameter("b", 2e-5, 1e-5, 3e-5, "s"),
    )
    section = Section(EI=EI, rhoA="rhoA")
    lump = Lump("4", mass="tip")
    return Beam(L, section, 4, supports_at={"1": "clamped"}, base="z", lumps=(lump,), parameters=parameters,
                damping=proportional(1.0, "b"))  # fmt: skip


def test_all_that_computes_frfs_of_it_agrees():
    """One by one, in a batch with the elements' mass as a parameter, in a diagnosis, by differences."""
    s, at = varied(), np.linspace(5.0, 700.0, 40)
    out = [Channel("a3", "acceleration", "response", "3", "z"), Channel("a5", "acceleration", "response", "5", "z")]
    theta = np.array([0.07, 2.2, 1.5e-5])
    plain = frf(s, theta, at, out, [BASE])
    batch = FrfBatch.of(s, at, out, [BASE])
    assert batch.engine is not None
    np.testing.assert_allclose(batch.frf(theta[None])[0], plain, rtol=1e-6)
    nominal = frf(s, s.nominal, at, out, [BASE])
    engine = Engine(s, out, [BASE], (30.0, 4400.0))
    seen = engine.response(engine.start((), np.empty(0)), (), 2j * np.pi * at).value
    np.testing.assert_allclose(seen, nominal, rtol=1e-6, atol=1e-6 * np.abs(nominal).max())
    _, slopes = frf_sensitivity(s, theta, at, out, [BASE])
    for j, step in enumerate((1e-6, 1e-5, 1e-10)):
        up, down = theta.copy(), theta.copy()
        up[j] += step
        down[j] -= step
        moved = (frf(s, up, at, out, [BASE]) - frf(s, down, at, out, [BASE])) / (2 * step)
        np.testing.assert_allclose(slopes[j], moved, rtol=1e-5, atol=1e-5 * np.abs(moved).max())


@pytest.mark.parametrize("made", [cantilever, column, in_matrices])
def test_a_sensor_at_the_clamp_moves_with_the_base_in_time_too(made):
    """An accelerometer and a pickup of displacement, one upside down: as in the FRF, and in a march."""
    s, at = made(4), np.linspace(20.0, 300.0, 12)
    held = [
        Channel("a", "acceleration", "response", "1", "z"),
        Channel("b", "acceleration", "response", "1", "-z"),
        Channel("d", "displacement", "response", "1", "z"),
        Channel("tip", "acceleration", "response", "5", "z"),
    ]
    value, plant = frf(s, [], at, held, [BASE])[:, 0], system(s, [], held, [BASE])
    np.testing.assert_allclose(value[:3], [1 + 0 * at, -1 + 0 * at, -1 / (2 * np.pi * at) ** 2], rtol=1e-9)
    np.testing.assert_allclose(plant.frf(at)[:, 0], value, rtol=1e-7)
    shaken = np.sin(2 * np.pi * 30 * np.arange(2000) / 4096)[None]
    seen = Simulation(plant, 1 / 4096).run(shaken)
    steps = seen.shape[1]
    np.testing.assert_allclose(seen[:2], np.vstack([shaken, -shaken])[:, :steps], atol=1e-9)
    assert np.abs(seen[3] - shaken[0, :steps]).max() > 0.01


def nothing(structure):
    """The structure with a mass of zero at node 4."""
    place = {"kind": "node", "id": "4"}
    return extend(structure, [{"id": "added-mass", "place": place, "parameters": {"mass": 0.0}}])


def test_a_mass_of_nothing_changes_nothing_wherever_the_parameters_are():
    """The load of what the supports hold follows the parameters in an extended model, one by one and in a batch."""
    s, at = varied(), np.linspace(5.0, 700.0, 40)
    tip = [Channel("a5", "acceleration", "response", "5", "z")]
    wide, theta = nothing(s), np.array([0.07, 1.185 * RHO_A, 1.5e-5])
    bare = frf(s, theta, at, tip, [BASE])
    np.testing.assert_allclose(frf(wide, np.append(theta, 0.0), at, tip, [BASE]), bare, rtol=1e-9)
    np.testing.assert_allclose(wide.held_load(np.append(theta, 0.0)), s.held_load(theta), atol=1e-15)
    batch = FrfBatch.of(wide, at, tip, [BASE])
    np.testing.assert_allclose(batch.frf(np.append(theta, 0.0)[None])[0], bare, rtol=1e-6)
    _, slopes = frf_sensitivity(wide, np.append(theta, 0.01), at, tip, [BASE])
    for j, step in enumerate((1e-6, 1e-5, 1e-10, 1e-6)):
        ends = [frf(wide, np.append(theta, 0.01) + way * step * np.eye(4)[j], at, tip, [BASE]) for way in (1, -1)]
        moved = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(slopes[j], moved, rtol=1e-5, atol=1e-5 * np.abs(moved).max())
