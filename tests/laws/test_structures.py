"""Laws that every structure obeys; one entry in STRUCTURES_AT_WORK for each kind and each notable combination."""

import numpy as np
import pytest

from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.response import frf, frf_sensitivity, modes, poles
from labnnum.structures import STRUCTURES, Beam, Chain, Frame, MatrixStructure, ModalStructure
from labnnum.structures.beam import Lump, Spring
from labnnum.structures.chain import Link
from labnnum.structures.examples import EXAMPLES
from labnnum.structures.frame import JointMass, JointSpring, Member, Profile
from labnnum.structures.modal import Mode
from labnnum.structures.quantities import modal, proportional, structural
from labnnum.structures.section import Section


def within(name, value, share=0.2, unit="1"):
    return Parameter(name, value, value * (1 - share), value * (1 + share), unit)


def based_chain():
    return Chain(
        {"1": "m", "2": 1.0},
        (Link("1", "ground", "k", "c"), Link("1", "2", 800.0)),
        (within("m", 2.0), within("k", 1e3), within("c", 1.0), within("zeta", 0.02)),
        damping=modal(0.01, "zeta"),
        base="x",
    )


def free_timoshenko():
    return Beam(
        "length",
        Section(wave="wave", mass="mass", E=2e11, G="G", kappa=0.85, rho=7850.0),
        7,
        "timoshenko",
        points={"a": 0.1, "b": 0.77},
        parameters=(
            within("length", 1.3),
            within("wave", 53.0),
            within("mass", 6.0),
            within("G", 77e9),
            within("z", 0.01),
        ),
        damping=modal("z"),
        axis="z",
        direction="x",
    )


def clamped_beam_with_everything():
    return Beam(
        "length",
        Section(E="E", nu=0.3, rho="rho", width="width", height="height", kappa="kappa"),
        5,
        "timoshenko",
        supports_at={"1": "clamped", "6": "guided"},
        points={"p": 0.33},
        lumps=(Lump("p", "m", "j"), Lump("4", 0.02)),
        springs=(Spring("p", "k", 0.1, "kr", 1e-4), Spring("5", 100.0, "c")),
        parameters=(
            within("length", 0.5), within("E", 7e10), within("rho", 2700.0), within("width", 0.03),
            within("height", 0.01), within("kappa", 0.8), within("m", 0.01), within("j", 1e-6), within("k", 2e3),
            within("kr", 2.0), within("c", 0.5), within("alpha", 1.0), within("beta", 1e-6),
        ),
        damping=proportional("alpha", "beta"),
        base="z",
    )  # fmt: skip


def point_beyond_a_shortened_end():
    return Beam(
        "length",
        Section(EI=100.0, rhoA=1.0),
        4,
        points={"tip": 1.05},
        supports_at={"1": "pinned", "3": "pinned"},
        parameters=(Parameter("length", 1.05, 0.9, 1.2), within("eta", 0.01)),
        damping=structural("eta"),
    )


def portal(plane):
    along = {"xy": (1, 0, 0), "xz": (1, 0, 0), "yz": (0, 1, 0)}[plane]
    up = {"xy": (0, 1, 0), "xz": (0, 0, 1), "yz": (0, 0, 1)}[plane]
    corner = {"1": (0, 0), "2": (0, 0.5), "3": (0.4, 0.5), "4": (0.4, 0), "5": (0.2, 0.5)}
    places = {n: tuple(a * x + b * y for a, b in zip(along, up, strict=True)) for n, (x, y) in corner.items()}
    turn = {"xy": "rz", "xz": "ry", "yz": "rx"}[plane]
    return Frame(
        places,
        {"bar": Profile(E="E", rho=7800.0, width=0.01, height=0.01, equivalent="L", reference=0.5)},
        tuple(Member(a, b, "bar") for a, b in (("1", "2"), ("2", "5"), ("5", "3"), ("3", "4"))),
        fixed={"1": ("x", "y", "z", "rx", "ry", "rz"), "4": ("x", "y", "z")},
        masses=(JointMass("2", "m", 1e-5),),
        springs=(JointSpring("4", turn, "kr", 0.01), JointSpring("2", plane[0], 10.0, "c", to="3")),
        plane=plane,
        parameters=(within("E", 2e11), within("L", 0.5), within("m", 0.1), within("kr", 50.0), within("c", 2.0)),
        base=plane[0],
    )


def from_matrices():
    source = based_chain()
    theta = source.nominal
    m, d = source.matrices(theta), source.derivatives(theta)
    pad = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    turn = np.linalg.inv(pad)

    def with_support(a):
        big = np.zeros((3, 3))
        big[1:, 1:] = a
        return turn.T @ big @ turn if a is m.K else big

    return MatrixStructure(
        with_support(m.M), with_support(m.K), ("0:x", "1:x", "2:x"),
        dM={"m": with_support(d[0].M)}, dK={"k": with_support(d[1].K)},
        parameters=(within("m", 2.0), within("k", 1e3), within("beta", 1e-4)),
        damping=proportional(0.5, "beta"), base="x", clamped=("0",), positions={"1": (0.0, 0.0, 0.0)},
    )  # fmt: skip


def from_damping_matrix():
    c = np.array([[2.0, -0.5], [-0.5, 1.0]])
    return MatrixStructure(
        np.eye(2), np.array([[200.0, -80.0], [-80.0, 90.0]]), ("1:x", "2:x"), C0=c, dC={"c": c / 2},
        dK={"k": np.diag([100.0, 0.0])}, parameters=(within("c", 1.0), within("k", 1.0)),
        damping=type(modal(0.1))("matrix"),
    )  # fmt: skip


def from_modes():
    return ModalStructure(
        (
            Mode(0.0, 0.0, {"1:x": 0.5, "2:x": 0.5}),
            Mode("f1", "z1", {"1:x": 1.0, "2:x": "phi"}),
            Mode(31.0, 0.02, {"1:x": 0.8, "2:x": 0.7}),
        ),
        {"1:x": "q"},
        (within("f1", 12.0), within("z1", 0.01), within("phi", -0.6, -0.2), within("q", 1e-5)),
    )


STRUCTURES_AT_WORK = {
    "chain-base": based_chain,
    "beam-free-timoshenko": free_timoshenko,
    "beam-everything": clamped_beam_with_everything,
    "beam-point-beyond-end": point_beyond_a_shortened_end,
    "frame-xy": lambda: portal("xy"),
    "frame-xz": lambda: portal("xz"),
    "frame-yz": lambda: portal("yz"),
    "matrices-base": from_matrices,
    "matrices-damping": from_damping_matrix,
    "modal": from_modes,
    **{name: (lambda make=make: make().structure) for name, make in EXAMPLES.items()},
}

ALL = pytest.mark.parametrize("make", STRUCTURES_AT_WORK.values(), ids=STRUCTURES_AT_WORK)


def somewhere(structure, seed=0):
    """Parameter values off the nominal, inside the bounds."""
    rng = np.random.default_rng(seed)
    low, high = (np.array([getattr(p, k) for p in structure.parameters]) for k in ("lower", "upper"))
    return low + (high - low) * rng.uniform(0.1, 0.9, low.size)


def sensor(dof, name="a"):
    node, way = dof.split(":")
    return Channel(name, "angle" if way.startswith("r") else "displacement", "response", node, way)


def actuator(dof, name="f"):
    node, way = dof.split(":")
    return Channel(name, "moment" if way.startswith("r") else "force", "reference", node, way)


def lines(structure):
    """Frequencies that straddle the first elastic modes, off the resonances of undamped structures."""
    f = modes(structure, structure.nominal).frequency
    f = f[f > 0][:4]
    return np.sort(np.concatenate([0.63 * f, 1.021 * f]))


def test_every_kind_is_at_work():
    assert {type(make()) for make in STRUCTURES_AT_WORK.values()} == set(STRUCTURES)


@ALL
def test_matrices_are_symmetric_and_positive(make):
    s = make()
    m = s.matrices(somewhere(s))
    for a in (m.M, m.C, m.K, m.D):
        np.testing.assert_allclose(a, a.T, atol=1e-12 * np.abs(a).max() + 1e-300)
        scale = np.sqrt(np.where(np.diag(a) > 0, np.diag(a), 1.0))
        assert np.linalg.eigvalsh(a / np.outer(scale, scale)).min() > -1e-9
    assert (np.diag(m.M) > 0).sum() >= m.M.shape[0] - (1 if isinstance(s, ModalStructure) else 0)
    assert all(a.shape == m.M.shape for a in (m.C, m.K, m.D))


@ALL
def test_reciprocity(make):
    s = make()
    places = s.dofs[:: max(1, len(s.dofs) // 5)][:5]
    outputs = [sensor(d, f"a{i}") for i, d in enumerate(places)]
    inputs = [actuator(d, f"f{i}") for i, d in enumerate(places)]
    h = frf(s, somewhere(s, 1), lines(s), outputs, inputs)
    scale = np.sqrt(np.abs(np.einsum("iif,jjf->ijf", h, h)))
    assert (np.abs(h - h.swapaxes(0, 1)) < 1e-9 * scale).all()


@ALL
def test_derivatives_of_matrices_are_those_of_differences(make):
    s = make()
    theta = somewhere(s, 2)
    exact = s.derivatives(theta)
    for j, p in enumerate(s.parameters):
        h = 1e-6 * (p.upper - p.lower)
        step = np.zeros(theta.size)
        step[j] = h
        up, down = s.matrices(theta + step), s.matrices(theta - step)
        whole = s.matrices(theta)
        for name in "MCKD":
            difference = (getattr(up, name) - getattr(down, name)) / (2 * h)
            rounding = 1e-15 * np.abs(getattr(whole, name)).max() / h
            size = np.abs(getattr(exact[j], name)).max()
            np.testing.assert_allclose(getattr(exact[j], name), difference, atol=1e-6 * size + 20 * rounding)


@ALL
def test_sensitivities_are_those_of_differences(make):
    s = make()
    theta = somewhere(s, 3)
    picked = [s.dofs[0], s.dofs[-1], s.dofs[len(s.dofs) // 2]]
    outputs = [sensor(d, f"a{i}") for i, d in enumerate(picked)]
    inputs = [actuator(s.dofs[-1])]
    if s.base:
        inputs.append(Channel("b", "acceleration", "base", "", s.base))
        outputs = [
            Channel(c.name, c.quantity.replace("displacement", "acceleration"), "response", c.node, c.direction)
            for c in outputs
        ]
    f = lines(s)
    value, slope = frf_sensitivity(s, theta, f, outputs, inputs)
    np.testing.assert_allclose(value, frf(s, theta, f, outputs, inputs), rtol=1e-8, atol=1e-10 * np.abs(value).max())
    for j, p in enumerate(s.parameters):
        found = richardson(lambda t: frf(s, t, f, outputs, inputs), theta, j, 2e-4 * (p.upper - p.lower))
        size = np.abs(slope[j]).max(axis=-1, keepdims=True)
        floor = 1e-9 * np.abs(value).max(axis=-1, keepdims=True) / (p.upper - p.lower)
        assert (np.abs(found - slope[j]) < 2e-5 * size + 100 * floor).all(), p.name


@ALL
def test_sensitivities_are_those_of_the_complex_step(make):
    """To rounding: the FRF is solved in real numbers, so that an imaginary step of a parameter stays apart."""
    s = make()
    theta = somewhere(s, 5)
    outputs, inputs = [sensor(s.dofs[0]), sensor(s.dofs[-1], "b")], [actuator(s.dofs[-1])]
    f = lines(s)
    _, slope = frf_sensitivity(s, theta, f, outputs, inputs)
    for j, p in enumerate(s.parameters):
        step = 1e-40 * (p.upper - p.lower)
        stepped = theta.astype(complex)
        stepped[j] += 1j * step
        real, imaginary = in_real_numbers(s, stepped, f, outputs, inputs)
        found = (real.imag + 1j * imaginary.imag) / step
        size = np.abs(slope[j]).max(axis=-1, keepdims=True)
        assert (np.abs(found - slope[j]) <= 1e-8 * size + 1e-300).all(), p.name


def in_real_numbers(s, theta, frequency, outputs, inputs):
    """Real and imaginary part of the receptance, each an analytic function of theta."""
    m = s.matrices(theta)
    places = [np.asarray(s.participation(c.dof, theta)) for c in (*outputs, *inputs)]
    out, drive = np.array(places[: len(outputs)]), np.array(places[len(outputs) :]).T
    n, value = len(m.M), []
    for w in 2 * np.pi * frequency:
        z, loss = m.K - w**2 * m.M, w * m.C + m.D
        u = np.linalg.solve(np.block([[z, -loss], [loss, z]]), np.vstack([drive, 0 * drive]))
        value.append((out @ u[:n], out @ u[n:]))
    return np.moveaxis(np.array(value), 0, -1)


def richardson(function, theta, j, h):
    """Central difference of the fourth order."""

    def at(k):
        moved = theta.copy()
        moved[j] += k * h
        return function(moved)

    return (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * h)


@ALL
def test_participation_sees_what_the_coordinates_do(make):
    s = make()
    theta = somewhere(s, 4)
    n = s.matrices(theta).M.shape[0]
    rows = np.array([s.participation(d, theta) for d in s.dofs])
    assert rows.shape == (len(s.dofs), n)
    assert (np.abs(rows).max(axis=1) > 0).all()
    if s.base:
        moved = rows @ s.rigid(theta)
        along = np.array([d.endswith(f":{s.base}") for d in s.dofs])
        np.testing.assert_allclose(moved, along, atol=1e-9)


@ALL
def test_poles_decay_and_match_the_modes(make):
    s = make()
    if isinstance(s, ModalStructure):
        pytest.skip("its residual coordinate has no mass")
    theta = s.nominal
    found, first = poles(s, theta), modes(s, theta)
    assert (found.real <= 1e-9 * np.abs(found)).all()
    omega = 2 * np.pi * first.frequency
    light = first.damping_ratio < 0.02
    if light[:2].all() and omega[0] > 0:
        nearest = [np.abs(found - 1j * w).min() / w for w in omega[:2]]
        assert max(nearest) < 0.03


@ALL
def test_geometry_names_what_there_is(make):
    s = make()
    known = {d.split(":")[0] for d in s.dofs} | set(s.supports)
    assert {n for pair in s.elements for n in pair} <= known | set(s.nodes)
    assert all(len(xyz) == 3 for xyz in s.nodes.values())
