import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labnnum.errors import ChannelError, ModelError
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.response import frf, frf_sensitivity, mode_sensitivity, model_frf, modes, poles
from labnnum.solvers import DenseSolver, ModalSolver, SparseSolver, modal_solver, solver
from labnnum.structures import Beam, Chain, Matrices
from labnnum.structures.beam import Lump
from labnnum.structures.chain import Link
from labnnum.structures.examples import EXAMPLES, truck, yang_brown
from labnnum.structures.quantities import modal, proportional, structural
from labnnum.structures.section import Section

M, C, K = 2.0, 3.0, 500.0
F = np.linspace(0.1, 8.0, 41)
S = 2j * np.pi * F


def oscillator(**more):
    return Chain({"1": M}, (Link("1", "ground", K, C),), **more)


def motion(quantity="displacement", direction="x", node="1", role="response"):
    return Channel("out", quantity, role, node, direction)


def force(direction="x", node="1", name="f"):
    return Channel(name, "force", "reference", node, direction)


BASE = Channel("base", "acceleration", "base", "", "x")


@pytest.mark.parametrize(("quantity", "power"), [("displacement", 0), ("velocity", 1), ("acceleration", 2)])
def test_sdof_closed_form(quantity, power):
    exact = S**power / (M * S**2 + C * S + K)
    value = frf(oscillator(), [], F, [motion(quantity)], [force()])[0, 0]
    np.testing.assert_allclose(value, exact, rtol=1e-12)


@pytest.mark.parametrize(("out", "drive", "sign"), [("-x", "x", -1), ("x", "-x", -1), ("-x", "-x", 1), ("+x", "x", 1)])
def test_signs_of_directions(out, drive, sign):
    exact = sign / (M * S**2 + C * S + K)
    np.testing.assert_allclose(frf(oscillator(), [], F, [motion(direction=out)], [force(drive)])[0, 0], exact)


def test_base_excitation_is_transmissibility_of_absolute_motion():
    exact = (C * S + K) / (M * S**2 + C * S + K)
    s = oscillator(base="x")
    np.testing.assert_allclose(frf(s, [], F, [motion("acceleration")], [BASE])[0, 0], exact, rtol=1e-12)
    np.testing.assert_allclose(frf(s, [], F, [motion("velocity")], [BASE])[0, 0], exact / S, rtol=1e-12)
    moved = Channel("base", "displacement", "base", "", "x")
    np.testing.assert_allclose(frf(s, [], F, [motion("displacement")], [moved])[0, 0], exact, rtol=1e-12)
    np.testing.assert_allclose(frf(s, [], F, [motion("acceleration")], [moved])[0, 0], exact * S**2, rtol=1e-12)


def test_base_channel_as_output_is_one_and_still_under_force():
    s = oscillator(base="x")
    out = frf(s, [], F, [BASE, motion("acceleration")], [BASE, force()])
    np.testing.assert_allclose(out[0, 0], 1.0)
    np.testing.assert_allclose(out[0, 1], 0.0)
    np.testing.assert_allclose(out[1, 1], S**2 / (M * S**2 + C * S + K), rtol=1e-12)


def test_structural_damping():
    s = Chain({"1": M}, (Link("1", "ground", K),), damping=structural(0.02))
    np.testing.assert_allclose(frf(s, [], F, [motion()], [force()])[0, 0], 1 / (M * S**2 + K * (1 + 0.02j)))


def test_truck_agrees_with_its_state_space():
    s = truck()
    m = s.matrices(s.nominal)
    inverse = np.linalg.inv(m.M)
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-inverse @ m.K, -inverse @ m.C]])
    b = np.vstack([np.zeros((3, 1)), inverse[:, :1]])
    w = 2 * np.pi * F
    for i in range(3):
        h = np.array([np.linalg.solve(1j * x * np.eye(6) - a, b)[i, 0] for x in w])
        ours = frf(s, s.nominal, F, [motion(node=str(i + 1))], [force()])[0, 0]
        np.testing.assert_allclose(ours, h, rtol=1e-9)
    mine = poles(s, s.nominal)
    theirs = np.linalg.eigvals(a)
    np.testing.assert_allclose(np.sort_complex(mine), np.sort_complex(theirs), rtol=1e-9)


def solve_all(m: Matrices, omega):
    load = np.eye(m.M.shape[0])[:, :2]
    return [way.solve(omega, load) for way in (DenseSolver(m, False), SparseSolver(m), modal_solver(m, omega)) if way]


@pytest.mark.parametrize("damping", [proportional(2.0, 1e-5), modal(0.01, 0.02), structural(0.01)])
def test_modal_and_direct_solutions_agree(damping):
    s = Beam(1.0, Section(E=2e11, rho=7800, width=0.03, height=0.01), 10, supports_at={"1": "clamped"}, damping=damping)
    found = solve_all(s.matrices(np.zeros(0)), 2 * np.pi * np.linspace(5, 900, 60))
    assert len(found) == 3
    scale = np.abs(found[0]).max(axis=(1, 2), keepdims=True)
    for other in found[1:]:
        assert (np.abs(other - found[0]) / scale).max() < 1e-9


def test_the_way_is_chosen_by_the_damping():
    s = yang_brown()
    assert isinstance(solver(s.matrices(s.nominal), np.array([100.0, 200.0])), DenseSolver)
    undamped = Chain({"1": 1.0, "2": 1.0}, (Link("1", "ground", 1.0), Link("1", "2", 1.0)))
    assert isinstance(solver(undamped.matrices(np.zeros(0)), np.array([0.3])), ModalSolver)
    long = Beam(10.0, Section(E=2e11, rho=7800, width=0.1, height=0.1), 320, supports_at={"1": "clamped"})
    assert isinstance(solver(long.matrices(np.zeros(0)), np.array([3.0])), SparseSolver)


def test_coupled_damping_uses_elimination_and_agrees_with_the_inverse():
    s = yang_brown(high=True)
    m = s.matrices(s.nominal)
    f = np.array([10.0, 31.0, 52.0, 200.0])
    exact = np.linalg.inv(m.dynamic_stiffness(2 * np.pi * f))[:, 10, 0]
    ours = frf(s, s.nominal, f, [motion(node="11")], [force()])[0, 0]
    np.testing.assert_allclose(ours, exact, rtol=1e-10)


def test_memory_is_bounded_by_blocks_of_lines(monkeypatch):
    example = EXAMPLES["frame"]()
    f = np.linspace(10, 40, 50)
    args = (example.structure, example.structure.nominal, f, example.outputs, example.inputs)
    whole, slope = frf_sensitivity(*args)
    monkeypatch.setattr("labnnum.response._CHUNK", 96 * 3 * 7)
    parts, slopes = frf_sensitivity(*args)
    np.testing.assert_allclose(parts, whole, rtol=1e-12)
    np.testing.assert_allclose(slopes, slope, rtol=1e-9)
    np.testing.assert_allclose(frf(*args), whole, rtol=1e-9)


class Faulty(Chain):
    """A chain seen through a gain 1 + theta[0] on responses and a delay theta[0] on forces."""

    def chain(self, channel, frequency, theta):
        if channel.role == "response":
            return np.full(frequency.shape, 1 + theta[0], complex)
        return np.exp(-2j * np.pi * frequency * theta[0])

    def chain_derivatives(self, channel, frequency, theta):
        if channel.role == "response":
            return np.ones((1, frequency.size), complex)
        s = -2j * np.pi * frequency
        return (s * np.exp(s * theta[0]))[None]


def test_measurement_chain_enters_value_and_sensitivity():
    s = Faulty({"1": "m"}, (Link("1", "ground", K, C),), (Parameter("m", 0.01, 0.0, 1.0),))
    theta, h = np.array([0.01]), 1e-6
    value, slope = frf_sensitivity(s, theta, F, [motion()], [force()])
    plain = Chain({"1": 0.01}, (Link("1", "ground", K, C),))
    factor = 1.01 * np.exp(2j * np.pi * F * 0.01)
    np.testing.assert_allclose(value[0, 0], frf(plain, [], F, [motion()], [force()])[0, 0] * factor, rtol=1e-12)
    up, down = (frf(s, theta + d, F, [motion()], [force()]) for d in (h, -h))
    np.testing.assert_allclose(slope[0], (up - down) / (2 * h), rtol=1e-6)


@given(zeta=st.floats(0.0, 3.0), omega=st.floats(0.1, 1e4))
@settings(max_examples=30, deadline=None)
def test_poles_of_one_mass(zeta, omega):
    s = Chain({"1": 1.0}, (Link("1", "ground", omega**2, 2 * zeta * omega),))
    root = np.sqrt(complex(zeta**2 - 1))
    exact = omega * np.array([-zeta + root, -zeta - root])
    found = poles(s, [])
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(exact), rtol=1e-6, atol=1e-7 * omega)


def test_poles_with_structural_damping():
    s = Chain({"1": M}, (Link("1", "ground", K),), damping=structural(0.04))
    upper = np.sqrt(complex(-K * (1 + 0.04j) / M))
    upper = upper if upper.imag > 0 else -upper
    np.testing.assert_allclose(poles(s, []), [upper, upper.conjugate()], rtol=1e-12)


def test_poles_with_a_massless_coordinate():
    """A spring and dashpot in series carry a mass: three finite poles."""
    s = Chain({"1": 1.0, "2": 0.0}, (Link("1", "2", 0.0, 2.0), Link("2", "ground", 50.0), Link("1", "ground", 100.0)))
    found = poles(s, [])
    exact = np.roots(np.polyadd(np.polymul([1, 0, 100.0], [2.0, 50.0]), [50.0 * 2.0, 0.0]))
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(exact), rtol=1e-8)


def test_modal_damping_ratios_come_back():
    s = Beam(1.0, Section(E=2e11, rho=7800, width=0.03, height=0.01), 6, damping=modal(0.01, 0.02, 0.03, 0.04))
    np.testing.assert_allclose(modes(s, [], 5).damping_ratio, [0.0, 0.0, 0.03, 0.04, 0.04], atol=1e-9)
    np.testing.assert_allclose(modes(s, [], 5).frequency[:2], 0.0)


def test_frequency_sensitivity_against_differences():
    s = yang_brown()
    found, slope = mode_sensitivity(s, s.nominal, 3)
    for j, p in enumerate(s.parameters):
        step = np.zeros(len(s.parameters))
        step[j] = 1e-4 * p.nominal
        change = modes(s, s.nominal + step, 3).frequency - modes(s, s.nominal - step, 3).frequency
        np.testing.assert_allclose(slope[j], change / (2e-4 * p.nominal), rtol=1e-5, atol=1e-9 * found.frequency[2])


def test_rotations_and_moments():
    s = Beam(1.0, Section(E=2e11, rho=7800, width=0.03, height=0.01), 4, supports_at={"1": "clamped"})
    tip = Channel("r", "angle", "response", "5", "ry")
    push, turn = force("z", "5"), Channel("m", "moment", "reference", "5", "ry")
    ei = 2e11 * 0.03 * 0.01**3 / 12
    out = frf(s, [], [0.0], [tip, Channel("w", "displacement", "response", "5", "z")], [push, turn])[..., 0].real
    np.testing.assert_allclose(out, [[-1 / (2 * ei), 1 / ei], [1 / (3 * ei), -1 / (2 * ei)]], rtol=1e-9)


def test_model_frf_is_an_frf():
    out = model_frf(oscillator(), [], F, [motion("acceleration")], [force()])
    assert out.estimator == "model"
    assert out.value.shape == (1, 1, F.size)


def undamped_line():
    s = Chain({"1": 1.0, "2": 1.0}, (Link("1", "ground", 1.0), Link("1", "2", 1.0)))
    return s, modes(s, []).frequency[:1]


def free_at_zero():
    return Chain({"1": 1.0, "2": 1.0}, (Link("1", "2", 1.0, 0.1),)), [0.0, 1.0]


def free_dense_at_zero():
    return Chain({"1": 1.0, "2": 2.0, "3": 1.0}, (Link("1", "2", 1.0, 0.1), Link("2", "3", 1.0))), [0.0, 1.0]


def negative_spring():
    return Chain({"1": 1.0}, (Link("1", "ground", -5.0, 0.1),)), [1.0]


def negative_dashpot():
    return Chain({"1": 1.0}, (Link("1", "ground", 5.0, -0.1),)), [1.0]


def negative_mass():
    return Chain({"1": -1.0}, (Link("1", "ground", 5.0, 0.1),)), [1.0]


def not_finite():
    return Chain({"1": float("nan")}, (Link("1", "ground", 5.0, 0.1),)), [1.0]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (undamped_line, "singular at 0.0983632 Hz.*add damping"),
        (free_at_zero, "moves freely at 0 Hz.*leave out"),
        (free_dense_at_zero, "moves freely at 0 Hz.*leave out"),
        (negative_spring, "unstable.*stiffness"),
        (negative_dashpot, "unstable: a pole lies at"),
        (negative_mass, "mass matrix is not positive"),
        (not_finite, "matrix M of the model is not finite"),
    ],
)
def test_what_has_no_response(make, said):
    s, f = make()
    with pytest.raises(ModelError, match=said):
        frf(s, [], f, [motion()], [force()])


def test_modes_and_poles_of_an_unstable_structure():
    s, _ = negative_spring()
    with pytest.raises(ModelError, match="unstable"):
        modes(s, [])
    with pytest.raises(ModelError, match="unstable"):
        poles(s, [])
    with pytest.raises(ModelError, match="no mass"):
        modes(Chain({"1": 0.0}, (Link("1", "ground", 1.0),)), [])


@pytest.mark.parametrize(
    ("out", "drive", "kind", "said"),
    [
        (motion(node="7"), force(), ModelError, "no degree of freedom '7:x'; it has 1:x"),
        (motion(direction="y"), force(), ModelError, "no degree of freedom '1:y'"),
        (Channel("v", "voltage", "response", "1", "x"), force(), ChannelError, "'v' measures voltage"),
        (motion(), Channel("v", "voltage", "reference", "1", "x"), ChannelError, "a force, a moment"),
        (Channel("a", "acceleration"), force(), ChannelError, "'a' has no place"),
        (motion(direction="rx"), force(), ChannelError, "must be x, y or z"),
        (Channel("a", "angle", "response", "1", "x"), force(), ChannelError, "must be rx, ry or rz"),
        (motion(), BASE, ModelError, "no base excitation"),
    ],
)
def test_channels_that_do_not_fit(out, drive, kind, said):
    with pytest.raises(kind, match=said):
        frf(oscillator(), [], F, [out], [drive])


def test_base_channels_that_do_not_fit():
    s = oscillator(base="x")
    with pytest.raises(ModelError, match="points in z"):
        frf(s, [], F, [motion()], [Channel("b", "acceleration", "base", "", "z")])
    with pytest.raises(ChannelError, match="expected a motion"):
        frf(s, [], F, [motion()], [Channel("b", "force", "base", "", "x")])
    with pytest.raises(ModelError, match="infinite at 0 Hz"):
        frf(s, [], [0.0], [motion()], [BASE])


def test_parameter_values_that_do_not_fit():
    s = truck()
    with pytest.raises(ModelError, match="5: m3, k2, k3, b2, b3"):
        frf(s, [1.0], F, [motion()], [force()])
    with pytest.raises(ModelError, match="parameter 'k3' is not finite"):
        frf(s, [1, 1, np.nan, 1, 1], F, [motion()], [force()])
    with pytest.raises(ModelError, match="frequencies"):
        frf(s, s.nominal, [-1.0], [motion()], [force()])


def test_a_lump_moves_all_frequencies_down():
    bare = Beam(1.0, Section(E=2e11, rho=7800, width=0.03, height=0.01), 6, supports_at={"1": "clamped"})
    loaded = Beam(
        1.0, Section(E=2e11, rho=7800, width=0.03, height=0.01), 6, supports_at={"1": "clamped"},
        lumps=(Lump("7", 0.1, 1e-4),),
    )  # fmt: skip
    assert (modes(loaded, [], 5).frequency < modes(bare, [], 5).frequency).all()
