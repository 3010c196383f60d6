"""Dashpots that stand at some places of a model couple its modes: exact receptances, derivatives, and no false name."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from labnnum.diagnosis.diagnose import diagnose
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.receptance import Base
from labnnum.diagnosis.observe import observe_frf
from labnnum.frf import Frf
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from sessions.diagnose import run_observed, write_extended
from sessions.model import read_model

OUTPUTS = tuple(Channel(f"a{n}", "acceleration", "response", node=n, direction="x") for n in ("1", "3", "5"))
FORCE = (Channel("force", "force", "reference", node="2", direction="x"),)
BASE = (Channel("base", "acceleration", "base", node="ground", direction="x"),)
SPRING = Parameter("k", 3e5, 2e5, 4e5, "N/m")


def chain(*dampings, base=""):
    """Five masses, the first tied to the ground; dashpots of the links, one after the other."""
    between = (("1", "ground"), ("1", "2"), ("2", "3"), ("3", "4"), ("4", "5"))
    links = tuple(Link(a, b, "k", c) for (a, b), c in zip(between, dampings, strict=True))
    masses = {str(i): m for i, m in zip(range(1, 6), (3.0, 2.0, 2.5, 2.0, 1.5), strict=True)}
    return Chain(masses, links, (SPRING,), base=base)


def stiffened(dampings):
    """The same with parameters of its own for the third spring, for the fourth and for the second dashpot."""
    plain = chain(*dampings)
    a, b, c, d, e = plain.links
    links = (a, replace(b, damping="c"), replace(c, stiffness="k3"), replace(d, stiffness="k4"), e)
    links = tuple(replace(x, stiffness=3e5) if x.stiffness == "k" else x for x in links)
    named = (replace(SPRING, name="k3"), replace(SPRING, name="k4"), Parameter("c", dampings[1], 50.0, 900.0, "N s/m"))
    return Chain(plain.masses, links, named)


HEAVY = (10.0, 400.0, 10.0, 10.0, 150.0)


def exact(structure, omega, *, base=False, theta=None):
    """Accelerations (3, n_f) per force, or per base acceleration, by the full matrices."""
    m = structure.matrices(structure.nominal if theta is None else theta)
    z = -(omega[:, None, None] ** 2) * m.M + 1j * omega[:, None, None] * m.C + m.K + 1j * m.D
    pushed = -structure.base_load(structure.nominal) if base else np.eye(5)[1]
    u = np.linalg.solve(z, np.broadcast_to(pushed[:, None], (omega.size, 5, 1)))[..., 0]
    return (1.0 - omega[:, None] ** 2 * u if base else -(omega[:, None] ** 2) * u)[:, [0, 2, 4]].T


@pytest.mark.parametrize("inputs", [FORCE, BASE])
def test_receptances_are_those_of_the_full_damping_matrix(inputs):
    structure, omega = chain(*HEAVY, base="x" if inputs is BASE else ""), 2 * np.pi * np.linspace(5.0, 110.0, 60)
    made = Engine(structure, OUTPUTS, inputs, (omega[0], omega[-1]))
    truth = exact(structure, omega, base=inputs is BASE)
    alone = made.response(made.start(), (), 1j * omega).value[:, 0]
    assert np.linalg.norm(alone - truth) > 0.01 * np.linalg.norm(truth)
    made.couple()
    together = made.response(made.start(), (), 1j * omega).value[:, 0]
    assert np.linalg.norm(together - truth) < 1e-9 * np.linalg.norm(truth)


def test_they_are_where_the_parameters_have_turned_the_modes():
    """Two springs that are off turn the modes, and what one dashpot damps of each with them."""
    structure, omega = stiffened(HEAVY), 2 * np.pi * np.linspace(5.0, 110.0, 60)
    theta = np.array([0.8, 1.2, 300.0]) * np.array([3e5, 3e5, 1.0])
    made = Engine(structure, OUTPUTS, FORCE, (omega[0], omega[-1]))
    made.couple()
    m = structure.matrices(theta)
    value, shape = eigh(m.K, m.M)
    own = np.log(np.diag(shape.T @ m.C @ shape) / (2 * np.sqrt(value)))
    point = replace(made.start(), theta=theta, log_zeta=own[made.band_modes])
    together = made.response(point, (), 1j * omega).value[:, 0]
    truth = exact(structure, omega, theta=theta)
    assert np.linalg.norm(together - truth) < 1e-7 * np.linalg.norm(truth)


def test_derivatives_by_the_damping_of_modes_hold_their_coupling():
    omega = 2 * np.pi * np.linspace(5.0, 60.0, 40)
    made = Engine(stiffened(HEAVY), OUTPUTS, FORCE, (omega[0], omega[-1]))
    made.couple()
    assert made.coupling is not None
    assert set(made.coupling.modes) - set(made.band_modes)  # one beside the band, whose damping follows
    rng = np.random.default_rng(3)
    at = made.start()
    at = replace(
        at,
        theta=at.theta * np.array([1.05, 0.93, 1.1]),
        log_zeta=at.log_zeta + 0.2 * rng.standard_normal(at.log_zeta.size),
        shift=at.shift + 0.002,
    )
    jacobian = made.response(at, (), 1j * omega, jacobian=True).jacobian
    assert jacobian is not None
    x = at.vector()
    for j in range(x.size):
        step = np.eye(x.size)[j] * 1e-5 * max(abs(x[j]), 1.0)
        above, below = (made.response(at.with_vector(x + d), (), 1j * omega).value for d in (step, -step))
        slope = (above - below) / (2 * step[j])
        np.testing.assert_allclose(jacobian[j], slope, atol=2e-6 * max(float(np.abs(slope).max()), 1e-9))


def test_what_damps_less_couples_less():
    structure, omega = chain(*HEAVY), 2 * np.pi * np.linspace(5.0, 110.0, 60)
    made = Engine(structure, OUTPUTS, FORCE, (omega[0], omega[-1]))
    made.couple()
    point = made.start()
    light = replace(point, log_zeta=point.log_zeta + np.log(0.1))
    truth = exact(chain(*(0.1 * c for c in HEAVY)), omega)
    value = made.response(light, (), 1j * omega).value[:, 0]
    assert np.linalg.norm(value - truth) < 1e-9 * np.linalg.norm(truth)


PLACES = np.array([[0.0, -1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0]]).T


def lines(top=110.0, n=56):
    """Lines of a period, the first zero."""
    return 2 * np.pi * np.arange(n) * top / (n - 1)


@pytest.mark.parametrize("inputs", [FORCE, BASE])
def test_laws_feel_the_same(inputs):
    """Receptances between sensors, input and the places of nonlinear forces, a sensor's lines fewer than all."""
    structure, omega = chain(*HEAVY, base="x" if inputs is BASE else ""), lines()
    made = Engine(structure, OUTPUTS, inputs, (30.0, omega[-1]))
    made.couple()
    few = np.arange(3, omega.size, 2)
    base = Base(made, made.start(), PLACES, omega, lines=few)
    r = base.at(base.start())
    m = structure.matrices(structure.nominal)
    full = np.linalg.inv(-(omega[:, None, None] ** 2) * m.M + 1j * omega[:, None, None] * m.C + m.K)
    load = -structure.base_load(structure.nominal) if inputs is BASE else np.eye(5)[1]
    rows = np.eye(5)[[0, 2, 4]]
    close = {"rtol": 1e-7, "atol": 1e-9 * np.abs(full).max()}
    np.testing.assert_allclose(r.g, np.einsum("na,fnm,mb->abf", PLACES, full, PLACES), **close)
    np.testing.assert_allclose(r.z, np.einsum("na,fnm,m->af", PLACES, full, load), **close)
    np.testing.assert_allclose(r.h, np.einsum("on,fnm,mb->obf", rows, full[few], PLACES), **close)
    plain = np.einsum("on,fnm,m->of", rows, full[few], load)
    plain = plain - (1.0 / omega[few] ** 2 if inputs is BASE else 0.0)
    np.testing.assert_allclose(r.plain, plain, **close)


@pytest.mark.parametrize(("decay", "top"), [(0.0, 60.0), (2.0, 60.0), (0.0, 110.0)])
def test_derivatives_that_a_law_feels_hold_the_coupling(decay, top):
    made = Engine(stiffened(HEAVY), OUTPUTS, FORCE, (30.0, 2 * np.pi * top))
    made.couple()
    base = Base(made, made.start(), PLACES, lines(), decay)
    rng = np.random.default_rng(5)
    x = base.start()
    x = x + 0.05 * rng.standard_normal(x.size) * np.where(np.arange(x.size) < 3, x, 1.0)
    x[base.cuts[3]] = 0.2
    slopes = base.derivatives(x, base.at(x))
    held = {*range(*base.cuts[[1, 2]])} if set(made.coupling.modes) - set(made.band_modes) else set()
    for j in range(x.size):
        if j in held:  # modes beside the band follow the damping of those in it, which no derivative tells
            continue
        step = np.eye(x.size)[j] * 1e-5 * max(abs(x[j]), 1.0)
        above, below = base.at(x + step), base.at(x - step)
        for one, name in zip(slopes, ("plain", "h", "z", "g"), strict=True):
            slope = (getattr(above, name) - getattr(below, name)) / (2 * step[j])
            np.testing.assert_allclose(one[j], slope, atol=3e-6 * max(float(np.abs(slope).max()), 1e-12), err_msg=name)


def test_damping_that_follows_the_stiffness_couples_nothing():
    made = Engine(chain(*(30.0,) * 5), OUTPUTS, FORCE, (30.0, 700.0))
    made.couple()
    assert made.coupling is None


def test_a_dashpot_that_the_model_has_is_no_missing_physics():
    structure = chain(*HEAVY)
    answer = diagnose(structure, [measured(structure)])
    assert answer.verdict in ("consistent", "parameters")
    assert answer.base_error[1] < 3e-3


def measured(structure, theta=None):
    """An FRF of the structure in noise of a thousandth, as an observation."""
    frequency = np.linspace(5.0, 110.0, 400)
    value = exact(structure, 2 * np.pi * frequency, theta=theta)
    sigma = 1e-3 * np.sqrt(np.mean(np.abs(value) ** 2, axis=1, keepdims=True)) * np.ones(value.shape)
    noise = np.random.default_rng(8).standard_normal((2, *value.shape)) / np.sqrt(2)
    value = value + sigma * (noise[0] + 1j * noise[1])
    return observe_frf(Frf(frequency, value[:, None], OUTPUTS, FORCE, None, (sigma**2)[:, None], 8.0, "H1"))


MASS = """
[[structure.mass]]
node = "{}"
mass = {}
"""
LINK = """
[[structure.link]]
between = ["{}", "{}"]
stiffness = "k"
damping = {}
"""


def test_the_extended_model_damps_as_was_measured_and_by_its_dashpots_once(tmp_path):
    structure = chain(*HEAVY)
    text = '[structure]\nkind = "chain"\ndirection = "x"\n' + "".join(MASS.format(*m) for m in structure.masses.items())
    text += "".join(LINK.format(x.a, x.b, x.damping) for x in structure.links)
    text += '\n[[parameter]]\nname = "k"\nunit = "N/m"\nnominal = 3e5\nlower = 2e5\nupper = 4e5\n'
    (tmp_path / "model.toml").write_text(text)
    model = read_model(tmp_path / "model.toml")
    truth = chain(*(1.5 * c for c in HEAVY))
    answer = run_observed([measured(truth)], model)
    assert answer.verdict in ("consistent", "parameters")
    write_extended(tmp_path / "extended.toml", model, answer)
    made = read_model(tmp_path / "extended.toml").structure
    loss, wanted = made.matrices(made.nominal).C, truth.matrices(truth.nominal).C
    assert np.linalg.norm(loss - wanted) < 0.01 * np.linalg.norm(wanted)
    again = run_observed([measured(truth)], read_model(tmp_path / "extended.toml"))
    assert again.verdict == "consistent"
