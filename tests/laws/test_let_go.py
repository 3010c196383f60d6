"""A clamp that gives together with anything else: the model is the structure on a spring, with the same thing added."""

import numpy as np
import pytest
from scipy.linalg import eigh

from labnnum.diagnosis.changed import changed
from labnnum.mechanisms import extend
from labnnum.mechanisms.attached import in_structure
from labnnum.mechanisms.changes import Freed
from labnnum.mechanisms.let_go import LetGo
from labnnum.nonlinear import Element, NonlinearSimulation
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.response import frf, frf_sensitivity, modes
from labnnum.structures import Beam, MatrixStructure
from labnnum.structures.beam import Lump, Spring
from labnnum.structures.section import Section
from labnnum.system import system

TURN, PUSH = 0.05, 2e-6
LAST = "7"
RHO_A = Parameter("rhoA", 0.324, 0.2, 0.4, "kg/m")
EI = Parameter("EI", 11.2, 8.0, 14.0, "N*m^2")


def beam(hold="clamped", more=None, springs=(), n=6, **other):
    held = {} if hold is None else {"1": hold}
    return Beam(0.4, Section(EI="EI", rhoA="rhoA"), n, supports_at=held | (more or {}), springs=springs,
                parameters=(EI, RHO_A), **other)  # fmt: skip


def gives(axes="ry", node="1"):
    values = {"z": {"compliance": PUSH}, "ry": {"compliance_turn": TURN}}
    parameters = {k: v for axis in axes.split(" and ") for k, v in values[axis].items()}
    return {"id": "support-compliance", "place": {"kind": "support", "id": node}, "variant": axes,
            "parameters": parameters}  # fmt: skip


def entry(name, kind="global", at="structure", to=None, variant="", **parameters):
    place = {"kind": kind, "id": at} | ({} if to is None else {"to": to})
    return {"id": name, "place": place, "variant": variant, "parameters": parameters}


BESIDE = {
    "mass": entry("added-mass", "node", LAST, mass=0.1),
    "ground spring": entry("ground-stiffness", "ground", LAST, variant="z", stiffness=500.0),
    "dashpot": entry("local-dashpot", "ground", "5", variant="z", damping=2.0),
    "dashpot at the clamp": entry("local-dashpot", "element", "1", "2", "z", damping=2.0),
    "turning dashpot at the clamp": entry("local-dashpot", "element", "1", "2", "ry", damping=0.2),
    "oscillator": entry("attached-oscillator", "node", "4", variant="z", mass=0.02, frequency=40.0, damping_ratio=0.02),
    "soft element": entry("joint-stiffness", "element", "3", "4", "element", relative_change=-0.4),
    "soft element at the clamp": entry("joint-stiffness", "element", "1", "2", "element", relative_change=-0.4),
    "loss": entry("hysteretic-damping", "element", "1", "2", loss_factor=0.1),
    "creep": entry("viscoelastic", "element", "1", "2", relative_k1=0.3, tau=1e-3),
    "tension": entry("axial-preload", tension=30.0),
    "shear": entry("shear-rotary", shear_time=2e-5),
}
OUT = [Channel(f"a{i}", "acceleration", "response", str(i), "z") for i in (2, 5, 7)]
PUSHED = Channel("f", "force", "reference", "6", "z")
LINES = np.linspace(3.0, 400.0, 60)


def sprung(axes="ry", **other):
    """The free beam on springs at node 1, as stiff as a clamp where it holds."""
    rotational = 1 / TURN if "ry" in axes else 1e9
    stiffness = 1 / PUSH if "z" in axes else 1e11
    return beam(None, springs=(Spring("1", stiffness=stiffness, rotational=rotational),), **other)


@pytest.mark.parametrize("what", sorted(BESIDE))
@pytest.mark.parametrize("axes", ["ry", "z", "z and ry"])
def test_what_stands_beside_a_clamp_that_gives(what, axes):
    inner, loose = beam(), sprung(axes)
    ours, theirs = extend(inner, [BESIDE[what], gives(axes)]), extend(loose, [BESIDE[what]])
    made = frf(ours, ours.nominal, LINES, OUT, [PUSHED])
    true = frf(theirs, theirs.nominal, LINES, OUT, [PUSHED])
    bare = frf(loose, loose.nominal, LINES, OUT, [PUSHED])
    assert np.abs(true - bare).max() > 1e-3 * np.abs(bare).max()
    np.testing.assert_allclose(made, true, rtol=1e-3, atol=1e-5 * np.abs(true).max())


def test_a_lump_and_a_ground_spring_on_the_sprung_beam():
    ours = extend(beam(n=20), [gives(), entry("added-mass", "node", "21", mass=0.1)])
    spring = Spring("1", rotational=1 / TURN)
    theirs = beam("pinned", springs=(spring,), lumps=(Lump("21", mass=0.1),), n=20)
    np.testing.assert_allclose(
        modes(ours, ours.nominal, 4).frequency, modes(theirs, theirs.nominal, 4).frequency, rtol=1e-6
    )
    ours = extend(beam(), [gives(), BESIDE["ground spring"]])
    theirs = beam("pinned", springs=(spring, Spring(LAST, stiffness=500.0)))
    np.testing.assert_allclose(
        modes(ours, ours.nominal, 4).frequency, modes(theirs, theirs.nominal, 4).frequency, rtol=1e-6
    )


@pytest.mark.parametrize("off", [(0.0, -0.001), (0.0, 0.05), (0.1, -0.2)])
def test_parameters_that_move_mass_and_stiffness(off):
    ours, theirs = extend(beam(n=20), [gives()]), sprung(n=20)
    theta = theirs.nominal * (1 + np.array(off))
    at = np.append(theta, TURN)
    np.testing.assert_allclose(modes(ours, at, 4).frequency, modes(theirs, theta, 4).frequency, rtol=1e-6)
    _, slope = frf_sensitivity(ours, at, LINES, OUT, [PUSHED])
    _, true = frf_sensitivity(theirs, theta, LINES, OUT, [PUSHED])
    for one, other in zip(slope, true, strict=False):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5 * np.abs(other).max())


def fitted(inner, theta, entries):
    """What the diagnosis fits of a structure at theta with entries of a model file."""
    added = extend(inner, entries).added
    terms = [in_structure(a.term, floats=False).fitted for a in added]
    values = [np.array([p.nominal for p in a.parameters]) for a in added]
    there, here = inner.matrices(theta), inner.matrices(inner.nominal)
    slopes = [(d.M, d.K) for d in inner.derivatives(theta)]
    changes = [(t.whole, v) for t, v in zip(terms, values, strict=True)]
    gone = LetGo.of(inner, [c for c, _ in changes if isinstance(c, Freed)])
    return changed(there.M, there.K, slopes, changes, theta - inner.nominal, here.M, gone), np.concatenate(values)


FITTED = ("mass", "ground spring", "soft element", "soft element at the clamp", "tension", "shear")


@pytest.mark.parametrize("axes", ["ry", "z", "z and ry"])
@pytest.mark.parametrize("what", FITTED)
def test_the_written_model_is_the_one_that_was_fitted(what, axes):
    """Modes of the diagnosis's own matrices with a clamp that gives, something beside it, and other parameters."""
    inner, entries = beam(), [gives(axes), BESIDE[what]]
    theta = inner.nominal * np.array([1.05, 1.0])
    made, own = fitted(inner, theta, entries)
    known = np.sqrt(eigh(made.stiffness, made.mass, eigvals_only=True)[:4]) / (2 * np.pi)
    written = extend(inner, entries)
    np.testing.assert_allclose(modes(written, np.append(theta, own), 4).frequency, known, rtol=1e-4)


@pytest.mark.parametrize("what", FITTED)
def test_a_fit_knows_how_it_goes_on(what):
    """Derivatives of the fit's matrices to the clamp's and the other's parameters, from differences."""
    inner, entries = beam(), [gives("z and ry"), BESIDE[what]]
    theta = inner.nominal * np.array([1.05, 1.0])
    made, own = fitted(inner, theta, entries)
    size = 1e-5 * own
    for j, step in enumerate(np.diag(size)):
        sides = []
        for sign in (1, -1):
            names = [list(e["parameters"]) for e in entries]
            moved = own + sign * step
            cut = np.split(moved, [len(names[0])])
            there = [
                e | {"parameters": dict(zip(n, v, strict=True))} for e, n, v in zip(entries, names, cut, strict=True)
            ]
            sides.append(fitted(inner, theta, there)[0])
        for k, part in enumerate(("mass", "stiffness")):
            true = (getattr(sides[0], part) - getattr(sides[1], part)) / (2 * size[j])
            slope = made.slopes[len(theta) + j][k]
            np.testing.assert_allclose(slope, true, atol=1e-6 * max(np.abs(true).max(), np.abs(slope).max(), 1e-9))


def test_a_ground_spring_beside_a_clamp_in_the_fit():
    """The beam on a turning spring with a spring at its tip, whose fit had the spring act beside the clamp's motion."""
    spring = (Spring("1", rotational=1 / TURN), Spring(LAST, stiffness=500.0))
    inner = beam()
    made, _ = fitted(inner, inner.nominal, [gives(), BESIDE["ground spring"]])
    known = np.sqrt(eigh(made.stiffness, made.mass, eigvals_only=True)[:4]) / (2 * np.pi)
    theirs = beam("pinned", springs=spring)
    np.testing.assert_allclose(modes(theirs, theirs.nominal, 4).frequency, known, rtol=1e-5)


@pytest.mark.parametrize("off", [0.0, 0.1])
def test_two_clamps_let_go_with_a_mass_between(off):
    ours = extend(beam(more={LAST: "clamped"}), [gives(), entry("added-mass", "node", "3", mass=0.1), gives(node=LAST)])
    springs = (Spring("1", rotational=1 / TURN), Spring(LAST, rotational=1 / TURN))
    theirs = beam("pinned", {LAST: "pinned"}, springs, lumps=(Lump("3", mass=0.1),))
    theta = theirs.nominal * np.array([1.0, 1.0 + off])
    at = np.concatenate([theta, [TURN, 0.1, TURN]])
    np.testing.assert_allclose(modes(ours, at, 4).frequency, modes(theirs, theta, 4).frequency, rtol=1e-6)


def test_two_motions_of_one_clamp_let_go_one_by_one():
    ours, theirs = extend(beam(), [gives("z"), gives("ry")]), sprung("z and ry")
    np.testing.assert_allclose(
        modes(ours, ours.nominal, 4).frequency, modes(theirs, theirs.nominal, 4).frequency, rtol=1e-6
    )


def in_matrices(*, springs=()):
    """The beam from matrices, its first node's rows clamped or on springs."""
    free = beam(None, springs=springs)
    m = free.matrices(free.nominal)
    dM, dK = ({p.name: getattr(d, k) for p, d in zip(free.parameters, free.derivatives(free.nominal), strict=True)}
              for k in "MK")  # fmt: skip
    clamped, carried = (("1",), ()) if not springs else ((), ("1",))
    return MatrixStructure(m.M, m.K, free.dofs, base="z", clamped=clamped, carried=carried, dM=dM, dK=dK,
                           parameters=free.parameters, positions=free.nodes)  # fmt: skip


def test_the_base_of_a_clamp_that_gives_pushes_as_the_springs_do():
    """On springs in both motions the whole beam is free: its load is that of all its mass."""
    ours = extend(in_matrices(), [gives("z and ry"), entry("added-mass", "node", LAST, mass=0.1)])
    springs = (Spring("1", stiffness=1 / PUSH, rotational=1 / TURN),)
    theirs = extend(in_matrices(springs=springs), [entry("added-mass", "node", LAST, mass=0.1)])
    base = [Channel("b", "acceleration", "base", "1", "z")]
    theta = theirs.nominal * np.array([1.05, 1.1, 1.0])
    at = np.concatenate([theta[:2], [PUSH, TURN, 0.1]])
    true = frf(theirs, theta, LINES, OUT, base)
    np.testing.assert_allclose(frf(ours, at, LINES, OUT, base), true, rtol=1e-5, atol=1e-6 * np.abs(true).max())


CUBIC = entry("cubic-stiffness", "ground", LAST, variant="z", k3=3e6)
AT_CLAMP = {
    "z": entry("cubic-stiffness", "joint", "1", "2", variant="z", k3=1e10),
    "ry": entry("cubic-stiffness", "joint", "1", "2", variant="ry", k3=3e7),
}


@pytest.mark.parametrize("law", [CUBIC, AT_CLAMP["z"], AT_CLAMP["ry"]], ids=["tip", "z", "ry"])
def test_a_law_acts_on_the_motion_that_is_seen(law):
    """Marched in time: the clamped beam let go and the beam on a spring, with the law at one motion."""
    damp = entry("local-dashpot", "ground", "4", variant="z", damping=3.0)
    made = []
    rate, n = 20_000.0, 3000
    t = np.arange(n) / rate
    force = 6 * np.sin(2 * np.pi * 9 * t)[None] * np.tanh(t / 0.02) ** 2
    for structure in (extend(beam(), [gives(), damp, law]), extend(sprung(), [damp, law])):
        seen = [Channel("x", "displacement", "response", LAST, "z")]
        plant = system(structure, structure.nominal, seen, [PUSHED])
        for elements in (structure.law_elements(), ()):
            assert all(isinstance(e, Element) and e.column.size == len(plant.M) for e in elements)
            made.append(NonlinearSimulation(plant, list(elements), 1 / rate).run(force)[0])
    ours, _, true, bare = made
    assert np.abs(true - bare).max() > 0.01 * np.abs(bare).max()
    np.testing.assert_allclose(ours, true, atol=1e-4 * np.abs(true).max())
