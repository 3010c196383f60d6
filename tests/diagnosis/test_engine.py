"""What the engine computes once, what a general law can follow, and how errors are weighed, by direct evaluation."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis.affine import affine
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.run import run_of
from labnnum.diagnosis.prediction import NODAL, relative_error
from labnnum.diagnosis.search import _inverse_root
from labnnum.errors import ModelError
from labnnum.frf import Frf
from labnnum.mechanisms.local_law import GeneralLaw
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.structures import Beam, MatrixStructure
from labnnum.structures.quantities import modal
from labnnum.structures.section import Section

MODULUS = Parameter("E", 7e10, 5e10, 9e10, "Pa", std=3e9)
LENGTH = Parameter("L", 1.0, 0.9, 1.1, "m", std=0.02)
OUTPUTS = tuple(Channel(f"a{n}", "acceleration", "response", node=n, direction="z") for n in ("3", "7"))
FORCE = (Channel("force", "force", "reference", node="1", direction="z"),)


def beam(*, supports=None, length=1.0, parameters=(MODULUS,), **more):
    section = Section(E="E", rho=2700.0, width=0.03, height=0.008)
    return Beam(length, section, 6, supports_at=supports or {}, parameters=parameters, damping=modal(0.01), **more)


def engine(structure, *, inputs=FORCE):
    return Engine(structure, OUTPUTS, inputs, (30.0, 2500.0))


def test_an_affine_structure_is_assembled_once_and_read_alike():
    made = engine(beam(supports={"1": "clamped"}), inputs=(replace(FORCE[0], node="4"),))
    theta = np.array([7.6e10])
    quick = made.state(theta)
    assert made._affine is not None
    made._affine = None
    plain = made._state(theta, [])
    for name in ("omega", "shape", "out", "load", "d_log", "sensors", "drives"):
        a, b = getattr(quick, name), getattr(plain, name)
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-10 * np.abs(b).max())


def test_a_structure_whose_length_may_change_is_no_affine_one():
    structure = beam(length="L", parameters=(MODULUS, LENGTH))
    assert affine(structure, ["3:z"], np.eye(14), on_base=False) is None
    assert affine(beam(), ["3:z"], np.eye(14), on_base=False) is not None


def test_rigid_motions_die_out_at_the_rate_that_is_asked():
    """What holds a free body takes 1 / s^2 to 1 / (s^2 + c w1 s)."""
    made = engine(beam())
    point = replace(made.start(), law=np.array([0.0, 0.02]))
    s = 2j * np.pi * np.array([0.5, 1.0, 2.0])
    damped, free = (made.response(p, (), s, modal=True) for p in (point, made.start()))
    np.testing.assert_allclose(damped.rigid, free.rigid / (1 + 0.02 * made.elastic / s), rtol=1e-7)


@pytest.mark.parametrize("index", [-1, -2, 0])
def test_derivatives_of_a_free_body(index):
    made = engine(beam())
    point = replace(made.start(), law=np.array([0.2, 0.03]))
    x, s = point.vector(), 2j * np.pi * np.linspace(10, 300, 40)
    slope = made.response(point, (), s, jacobian=True).jacobian[index]
    step = np.zeros_like(x)
    step[index] = 1e-5 * max(abs(x[index]), 0.1)
    ahead, behind = (made.response(point.with_vector(y), (), s).value for y in (x + step, x - step))
    numeric = (ahead - behind) / (2 * step[index])
    assert np.abs(slope - numeric).max() < 1e-5 * np.abs(numeric).max()


@pytest.mark.parametrize("order", [0.3, 0.5, 0.7])
def test_a_general_law_follows_a_fractional_loss_over_a_decade_and_a_half(order):
    s = 1j * np.geomspace(0.2, 6.0, 60)
    law = GeneralLaw(1.0)
    value = s**order
    basis = law.basis(s).T
    rows, right = np.concatenate([basis.real, basis.imag]), np.concatenate([value.real, value.imag])
    p = np.linalg.lstsq(rows, right, rcond=None)[0]
    assert np.abs(law.value(s, p) - value).max() < 0.01 * np.abs(value).max()


def test_a_sensor_beside_a_node_weighs_as_its_neighbours():
    rng = np.random.default_rng(3)
    f = np.linspace(10, 100, 50)
    large = rng.standard_normal((2, 1, 50)) + 0j
    large[1] *= 1e-3
    frf = Frf(f, large, OUTPUTS, FORCE, None, None, 1.0, "H1", {})
    wrong = large.copy()
    wrong[1] += 1e-3 * rng.standard_normal(50)  # as large as what that sensor reads
    seen = relative_error(frf, wrong)
    assert seen < 3e-3 / NODAL
    plain = np.sum(np.abs(wrong - large) ** 2, axis=2) / np.sum(np.abs(large) ** 2, axis=2)
    assert np.sqrt(plain.mean()) > 0.5


def test_noise_of_the_input_counts_on_detection_lines():
    """Where the input is recorded with noise, what it leads to one expects is noise of the responses too."""
    rng = np.random.default_rng(5)
    periods, n, gain = 40, 400, 50.0
    u = np.zeros(n, complex)
    on = np.zeros(n, bool)
    on[21:381:2] = True
    u[on] = np.exp(2j * np.pi * rng.random(on.sum()))
    noise = 0.01 * (rng.standard_normal((periods, n)) + 1j * rng.standard_normal((periods, n)))
    spectra = np.stack([u + noise, np.broadcast_to(gain * u, (periods, n))], axis=1)
    run = run_of(spectra, on, [0], [1], 1000.0, 2 * (n - 1), 1.0, "run", (FORCE[0], OUTPUTS[0]))
    at = np.flatnonzero(run.quiet)[10:-10]
    expected = gain**2 * 2e-4 / periods
    assert np.mean(run.noise[0, at]) == pytest.approx(expected, rel=0.1)


def test_profile_takes_errors_of_any_size():
    rng = np.random.default_rng(1)
    b = rng.standard_normal((2, 40, 5))
    b[1, :, 3] = b[1, :, 2] + 1e-9 * b[1, :, 3]
    b[1] *= 1e9
    gram = np.matmul(b.transpose(0, 2, 1), b) + np.eye(5)
    root = _inverse_root(gram)
    assert np.allclose(root[0] @ root[0].T, np.linalg.inv(gram[0]), rtol=1e-9)
    assert np.isfinite(root[1]).all()
    left = np.eye(40) - b[1] @ root[1] @ root[1].T @ b[1].T
    assert np.linalg.norm(left @ b[1, :, 0]) < 1e-6 * np.linalg.norm(b[1, :, 0])


def test_modes_keep_their_sign_where_both_ends_move_alike():
    """Odd modes of a free beam are largest at one end or the other, by rounding: their errors must not change sides."""
    made = engine(beam())
    nominal = made.state(np.array([7e10])).shape
    mass = np.real(made.structure.matrices(made.theta0).M)
    for change in (1e-12, 1e-9, -1e-9, 1e-7, -1e-6, 1e-5, -1e-4, 3e-3, -3e-3, 0.05, -0.05):
        shape = made.state(np.array([7e10 * (1 + change)])).shape[:, made.band_modes]
        assert np.all(np.sum(shape * (mass @ nominal[:, made.band_modes]), axis=0) > 0.9)


def test_a_motion_without_mass_is_refused_whatever_rounding_leaves_of_it():
    """Masses on a base that is free to move too and has none of its own: M of the relative motions and the base."""
    own = np.array([0.70235099, 0.74959222, 0.47347135, 0.52120171, 0.59816564, 0.4719037])
    for more in (0.0, 2e-16, 4e-16):  # which of these a factorisation takes for positive depends on rounding
        mass = np.block([[np.diag(own), own[:, None]], [own[None], np.array([[own.sum() + more]])]])
        stiffness = 100.0 * np.eye(7)
        channels = [Channel(f"a{i}", "acceleration", "response", node=str(i), direction="x") for i in (1, 2)]
        force = Channel("f", "force", "reference", node="1", direction="x")
        dofs = tuple(f"{i}:x" for i in range(1, 8))
        structure = MatrixStructure(mass, stiffness, dofs)
        with pytest.raises(ModelError, match="mass matrix is not positive definite"):
            Engine(structure, channels, (force,), (1.0, 30.0))
