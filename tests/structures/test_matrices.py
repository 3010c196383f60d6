"""Structures from matrices, from modes, chains and the damping they share: what is accepted and what is refused."""

import numpy as np
import pytest

from labnnum.errors import ConfigError, ModelError
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.response import frf, modes
from labnnum.structures import Chain, MatrixStructure, ModalStructure
from labnnum.structures.chain import Link
from labnnum.structures.modal import Mode, from_residues
from labnnum.structures.quantities import Damping, modal, proportional

M0, K0 = np.diag([1.0, 2.0]), np.array([[300.0, -100.0], [-100.0, 100.0]])
DOFS = ("1:z", "2:z")
P = Parameter("k", 1.0, 0.5, 1.5)


def two(**more):
    return MatrixStructure(**({"M0": M0, "K0": K0, "all_dofs": DOFS} | more))


def test_matrices_are_linear_about_the_nominal():
    s = two(dK={"k": K0 / 2}, dM={"k": M0}, parameters=(P,))
    m = s.matrices(np.array([1.25]))
    np.testing.assert_allclose(m.K, 1.125 * K0)
    np.testing.assert_allclose(m.M, 1.25 * M0)


def test_a_damping_matrix_counts_only_with_its_kind():
    c = np.diag([3.0, 4.0])
    np.testing.assert_allclose(two(C0=c, damping=Damping("matrix")).matrices(np.zeros(0)).C, c)
    np.testing.assert_allclose(two(C0=c, damping=proportional(0.5)).matrices(np.zeros(0)).C, 0.5 * M0)


def test_modal_damping_follows_equation_about_the_nominal_modes():
    s = two(damping=modal("z", 0.02), dK={"k": K0}, parameters=(P, Parameter("z", 0.01, 0.0, 0.1)))
    np.testing.assert_allclose(s.matrices(np.array([1.3, 0.01])).C, s.matrices(s.nominal).C)
    np.testing.assert_allclose(modes(s, s.nominal).damping_ratio, [0.01, 0.02], rtol=1e-9)


def test_clamped_nodes_are_removed_and_move_with_the_base():
    big = np.array([[200.0, -200.0, 0.0], [-200.0, 300.0, -100.0], [0.0, -100.0, 100.0]])
    s = MatrixStructure(np.diag([9.0, 1.0, 2.0]), big, ("0:z", *DOFS), base="z", clamped=("0",), damping=modal(0.01))
    plain = two(base="z", damping=modal(0.01))
    base = Channel("b", "acceleration", "base", "0", "z")
    out = [Channel("a", "acceleration", "response", n, "z") for n in ("0", "1", "2")]
    f = np.linspace(0.5, 4, 9)
    found = frf(s, [], f, out, [base])
    np.testing.assert_allclose(found[0, 0], 1.0)
    np.testing.assert_allclose(found[1:], frf(plain, [], f, out[1:], [base]), rtol=1e-12)
    assert s.dofs == DOFS
    assert s.supports == ("0",)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"M0": np.eye(3)}, r"matrix M0 has shape \(3, 3\): expected \(2, 2\)"),
        ({"K0": np.array([[1.0, 2.0], [0.0, 1.0]])}, "K0 is not symmetric"),
        ({"K0": np.array([[1.0, np.nan], [np.nan, 1.0]])}, "K0 is not finite"),
        ({"dK": {"k": np.eye(3)}, "parameters": (P,)}, "matrix dK_k has shape"),
        ({"all_dofs": ("1z", "2:z")}, "'1z' is not \"node:direction\""),
        ({"all_dofs": ("1:z", "1:z")}, "'1:z' stands there twice"),
        ({"clamped": ("1", "2")}, "nothing is left"),
        ({"base": "rx"}, "base = 'rx'"),
        ({"parameters": (P,)}, "parameter 'k' is used by nothing"),
        ({"damping": modal("zeta")}, "'zeta', which is not declared"),
        ({"parameters": (P, P), "dK": {"k": K0}}, "two parameters are named 'k'"),
    ],
)
def test_matrices_that_do_not_fit(more, said):
    with pytest.raises(ConfigError, match=said):
        two(**more)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Damping("rayleigh"), "'rayleigh' is not one of"),
        (lambda: Damping("modal"), "needs ratio"),
        (lambda: proportional(-1.0), "alpha = -1.0"),
        (lambda: modal(float("nan")), "ratio = nan"),
        (lambda: Chain({}, ()), "at least one mass"),
        (lambda: Chain({"1": 1.0}, (Link("1", "7", 1.0),)), "there is no mass '7'; there are 1, ground"),
        (lambda: Chain({"1": 1.0}, (Link("1", "1", 1.0),)), "joins a node with itself"),
        (lambda: Chain({"1": 1.0}, (), base="z"), "the chain moves along x"),
        (lambda: ModalStructure(()), "at least one mode"),
        (lambda: ModalStructure((Mode(1.0, 0.1, {"1:x": 1.0}), Mode(2.0, 0.1, {"2:x": 1.0}))), "mode 2: its shape"),
        (lambda: ModalStructure((Mode(1.0, 0.1, {"1:x": 1.0}),), {"3:x": 1.0}), "flexibility at '3:x'"),
    ],
)
def test_what_cannot_be_built(make, said):
    with pytest.raises(ConfigError, match=said):
        make()


def test_modal_damping_wants_mass_everywhere_it_vibrates():
    s = Chain({"1": 1.0, "2": 0.0}, (Link("1", "ground", 1.0), Link("1", "2", 1.0)), damping=modal(0.01))
    np.testing.assert_allclose(modes(s, []).damping_ratio, [0.01])


def test_modal_sum_in_closed_form():
    shape = ({"1:x": 0.9, "2:x": 0.4}, {"1:x": -0.3, "2:x": 0.8})
    s = ModalStructure((Mode(10.0, 0.01, shape[0]), Mode(25.0, 0.02, shape[1])), {"1:x": 2e-6, "2:x": 3e-6})
    f = np.linspace(1, 40, 50)
    w = 2 * np.pi * f
    place = [Channel(f"x{n}", "displacement", "response", n, "x") for n in "12"]
    push = [Channel(f"f{n}", "force", "reference", n, "x") for n in "12"]
    found = frf(s, [], f, place, push)
    for i, a in enumerate(("1:x", "2:x")):
        for j, b in enumerate(("1:x", "2:x")):
            exact = (
                sum(
                    p[a] * p[b] / (w0**2 - w**2 + 2j * z * w0 * w)
                    for p, w0, z in zip(shape, (20 * np.pi, 50 * np.pi), (0.01, 0.02), strict=True)
                )
                + (a == b) * (2e-6, 3e-6)[i]
            )
            np.testing.assert_allclose(found[i, j], exact, rtol=1e-9)


def test_a_residual_flexibility_is_positive():
    s = ModalStructure((Mode(10.0, 0.01, {"1:x": 1.0}),), {"1:x": "q"}, (Parameter("q", 0.0, -1.0, 1.0),))
    with pytest.raises(ModelError, match="must be positive"):
        s.matrices(s.nominal)


def test_poles_and_residues_come_back():
    modes_given = (Mode(10.0, 0.01, {"1:x": 0.9, "2:x": 0.4}), Mode(25.0, 0.02, {"1:x": 0.3, "2:x": -0.8}))
    s = ModalStructure(modes_given)
    poles, residues = [], {"1:x": [], "2:x": []}
    for m in modes_given:
        w = 2 * np.pi * float(m.frequency)
        poles.append(w * (-float(m.damping_ratio) + 1j * np.sqrt(1 - float(m.damping_ratio) ** 2)))
        for dof, r in residues.items():
            r.append(float(m.shape[dof]) * float(m.shape["1:x"]) / (2j * poles[-1].imag))
    again = from_residues(poles, residues, "1:x")
    f = np.linspace(1, 40, 30)
    place = [Channel(f"x{n}", "displacement", "response", n, "x") for n in "12"]
    push = [Channel("f", "force", "reference", "1", "x")]
    np.testing.assert_allclose(frf(again, [], f, place, push), frf(s, [], f, place, push), rtol=1e-9)
    with pytest.raises(ConfigError, match="lack the driven place"):
        from_residues(poles, residues, "3:x")
    with pytest.raises(ConfigError, match="wrong sign"):
        from_residues(poles, {d: [-x for x in r] for d, r in residues.items()}, "1:x")
    with pytest.raises(ConfigError, match="complex modes"):
        from_residues(poles, {"1:x": residues["1:x"], "2:x": [1j * x for x in residues["2:x"]]}, "1:x")
    with pytest.raises(ConfigError, match="negative real"):
        from_residues([1 + 1j, 2j], residues, "1:x")
