"""What the modes above the basis give way by at other parameters: against whole matrices, and by differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.receptance import Base
from labnnum.mechanisms import AddedMass, GroundStiffness
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.structures.frame import Frame, Member, Profile
from labnnum.structures.quantities import modal

TOP = Channel("force", "force", "reference", node="8", direction="y")
OUTPUTS = (
    Channel("a1", "acceleration", "response", node="8", direction="y"),
    Channel("a2", "acceleration", "response", node="10", direction="y"),
    Channel("a3", "acceleration", "response", node="8", direction="x"),
)
THETA = np.array([1.8e11, 2.3e11])


def portal(ratio=1e-5):
    """Clamped columns 0-4-8 and 3-7-11, a beam on top; both are shaken from above, where columns only shorten."""
    section = {"width": 0.03, "height": 0.005}
    nodes = {str(4 * i + j): (x, 0.1 * i, 0.0) for i in range(3) for j, x in ((0, 0.0), (3, 0.4))}
    nodes |= {"9": (0.13, 0.2, 0.0), "10": (0.27, 0.2, 0.0)}
    pairs = [("0", "4"), ("4", "8"), ("3", "7"), ("7", "11"), ("8", "9"), ("9", "10"), ("10", "11")]
    names = ["columns"] * 4 + ["beams"] * 3
    return Frame(
        nodes,
        {name: Profile(E=f"E_{name}", rho=7800.0, **section) for name in ("columns", "beams")},
        tuple(Member(a, b, name) for (a, b), name in zip(pairs, names, strict=True)),
        fixed={"0": ("x", "y", "rz"), "3": ("x", "y", "rz")},
        plane="xy",
        parameters=tuple(Parameter(f"E_{n}", 2.1e11, 1.5e11, 2.6e11, "Pa", std=1e10) for n in ("columns", "beams")),
        damping=modal(ratio),
    )


@pytest.fixture(scope="module")
def engine():
    return Engine(portal(), OUTPUTS, (TOP,), (2 * np.pi * 10, 2 * np.pi * 60))


def test_a_column_that_is_shaken_from_above_gives_way_by_its_modulus(engine):
    s = 2j * np.pi * np.array([3.0, 9.0, 61.0])
    point = replace(engine.start(), theta=THETA)
    value = engine.response(point, (), s).value
    m = engine.structure.matrices(THETA)
    rows = np.array([engine.participation(c.dof, THETA) for c in OUTPUTS])
    drive = engine.participation(TOP.dof, THETA)
    exact = [z**2 * rows @ np.linalg.solve(np.real(m.K) + z**2 * np.real(m.M), drive) for z in s]
    off = np.abs(value[:, 0] - np.array(exact).T) / np.abs(np.array(exact).T)
    assert off[0].max() < 0.004  # a modulus of 14 % less
    nominal = engine.remainder.at(engine.theta0)
    frozen = nominal.between(engine.state(THETA).high_out, engine.state(THETA).high_in)[0, 0]
    assert abs(frozen / (value[0, 0, 0] / s[0] ** 2).real - 1) > 0.1


def test_all_stiffness_scaled_alike_is_exact(engine):
    soft = engine.remainder.at(0.8 * engine.theta0)
    np.testing.assert_allclose(soft.value, np.eye(len(soft.value)) / 0.8, atol=1e-9)


def test_a_column_that_is_shaken_from_above_loses_what_its_damping_takes():
    """The imaginary part at lines far below where it swings along itself, viscous and hysteretic."""
    one = Engine(portal(0.02), OUTPUTS[:1], (TOP,), (2 * np.pi * 10, 2 * np.pi * 60))
    s = 2j * np.pi * np.array([3.0, 9.0, 61.0])
    m = one.structure.matrices(one.theta0)
    drive = one.participation(TOP.dof, one.theta0)
    point = one.start()
    for share in (0.0, 1.0):
        value = one.response(replace(point, law=np.array([share])), (), s).value[0, 0] / s**2
        loss = [z.imag * np.real(m.C) for z in s]
        if share:
            w2, v = eigh(np.real(m.K), np.real(m.M))
            rows = np.real(m.M) @ v
            loss = [rows @ np.diag(0.04 * w2) @ rows.T] * 3
        exact = [
            drive @ np.linalg.solve(np.real(m.K) + 1j * c + z**2 * np.real(m.M), drive)
            for z, c in zip(s, loss, strict=True)
        ]
        np.testing.assert_allclose(value.imag, np.imag(exact), rtol=0.02)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("index", [0, 1, "damping", "law"])
def test_derivatives(engine, held, index):
    terms = ()
    if held:
        site = engine.site(("4", "9", "10"), (("4", "8"),), ())
        terms = tuple(
            next(t for t in kind.terms(site) if t.place.id == place)
            for kind, place in ((GroundStiffness(), "10"), (AddedMass(), "9"))
        )
    point = engine.start(terms, [3e4, 0.05][: len(terms)])
    point = replace(point, theta=THETA, law=np.array([0.3]), log_zeta=np.log(0.02) + 0.1 * point.shift)
    x, s = point.vector(), 2j * np.pi * np.array([3.0, 9.0, 61.0])
    n_b = point.shift.size
    index = {"damping": x.size - 1 - 2 * n_b, "law": x.size - 1}.get(index, index)
    slope = engine.response(point, terms, s, jacobian=True).jacobian[index]
    step = np.zeros_like(x)
    step[index] = 1e-5 * abs(x[index])
    ahead, behind = (engine.response(point.with_vector(y), terms, s).value for y in (x + step, x - step))
    numeric = (ahead - behind) / (2 * step[index])
    np.testing.assert_allclose(slope, numeric, atol=2e-5 * np.abs(numeric).max(axis=(1, 2)).min())


@pytest.mark.parametrize("index", [0, 1])
def test_derivatives_of_receptances_at_places(engine, index):
    columns = np.zeros((len(engine.structure.dofs), 2))
    for i, dof in enumerate(("8:y", "9:y")):
        columns[:, i] = engine.participation(dof, THETA)
    omega = 2 * np.pi * np.array([3.0, 9.0, 61.0])
    base = Base(engine, replace(engine.start(), theta=THETA), columns, omega)
    x = base.start()
    x[-1] = 0.1  # a place that gives way by more
    slopes = base.derivatives(x, base.at(x))
    step = np.zeros_like(x)
    step[index] = 1e-5 * x[index]
    ahead, behind = base.at(x + step), base.at(x - step)
    for slope, name in zip(slopes, ("plain", "h", "z", "g"), strict=True):
        numeric = (getattr(ahead, name) - getattr(behind, name)) / (2 * step[index])
        np.testing.assert_allclose(slope[index], numeric, atol=2e-5 * np.abs(numeric).max())
