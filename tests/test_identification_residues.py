"""Poles and complex residues: exact where there is no noise, with deviations that mean what they say where there is."""

import numpy as np
import pytest

from labnnum.errors import EstimationError
from labnnum.frf import Frf
from labnnum.identification_residues import fit_residues
from labnnum.recording import Channel
from labnnum.response import frf as model_frf
from labnnum.structures import Chain
from labnnum.structures.chain import Link

FORCE = (Channel("f", "force", "reference", "1", "x"),)
QUANTITIES = ("acceleration", "displacement", "velocity")
MIXED = tuple(Channel(f"r{i}", q, "response", str(i), "x") for i, q in enumerate(QUANTITIES, 1))
LINES = np.linspace(2.0, 12.0, 400)


def damped(end=20.0):
    """A chain whose dashpot at one end makes its modes complex, with exact poles and residues (n_modes, n_out)."""
    links = (
        Link("1", "ground", 2000.0, end), Link("1", "2", 1500.0, 0.3), Link("2", "3", 1800.0, 0.3),
        Link("3", "ground", 900.0, 0.3),
    )  # fmt: skip
    structure = Chain({"1": 1.0, "2": 1.2, "3": 0.9}, links)
    m = structure.matrices(structure.nominal)
    zero, mass, damping, stiffness = np.zeros((3, 3)), m.M.real, m.C.real, m.K.real
    a, b = np.block([[damping, mass], [mass, zero]]), np.block([[stiffness, zero], [zero, -mass]])
    poles, vectors = np.linalg.eig(-np.linalg.solve(a, b))
    poles, vectors = poles[poles.imag > 0], vectors[:, poles.imag > 0]
    order = np.argsort(np.abs(poles))
    poles, vectors = poles[order], vectors[:, order]
    residues = vectors[:3] * vectors[0] / np.einsum("ik,ij,jk->k", vectors, a, vectors)
    return structure, poles, residues.T


def measured(structure, outputs, noise=0.0, seed=0, lines=LINES, stated=True):
    """FRFs with noise of a share of the response on each line."""
    value = model_frf(structure, structure.nominal, lines, outputs, FORCE)
    normal = np.random.default_rng(seed).standard_normal((2, *value.shape)) / np.sqrt(2)
    size = noise * np.abs(value)
    return Frf(lines, value + size * (normal[0] + 1j * normal[1]), outputs, FORCE, variance=size**2 if stated else None)


def near(poles):
    """Frequencies and damping ratios somewhat off."""
    return np.column_stack([np.abs(poles) / 2 / np.pi * (1 + 0.1 * -poles.real / np.abs(poles)),
                            1.4 * -poles.real / np.abs(poles)])  # fmt: skip


def test_without_noise_poles_and_complex_residues_are_exact():
    structure, poles, residues = damped()
    found = fit_residues(measured(structure, MIXED), near(poles))
    np.testing.assert_allclose(found.poles, poles, rtol=1e-6)
    np.testing.assert_allclose(found.residue, residues, rtol=1e-4, atol=1e-6 * np.abs(residues).max())
    assert found.error < 1e-6
    assert found.collinearity.min() < 0.99
    assert (found.collinearity <= 1 + 1e-12).all()


def test_residues_are_along_the_axes_of_the_places():
    """A sensor that points the other way measures the same structure."""
    structure, poles, residues = damped()
    turned = (Channel("r", "acceleration", "response", "1", "-x"), *MIXED[1:])
    found = fit_residues(measured(structure, turned), near(poles))
    np.testing.assert_allclose(found.residue, residues, rtol=1e-4, atol=1e-6 * np.abs(residues).max())


@pytest.mark.parametrize("stated", [True, False])
def test_errors_are_as_large_as_their_deviations_say(stated):
    """Over 20 draws; where the noise is not stated it is estimated, though it is not the same on all lines."""
    structure, poles, residues = damped()
    off = []
    for seed in range(20):
        found = fit_residues(measured(structure, MIXED, 0.01, seed, stated=stated), near(poles))
        off.append([
            *((found.frequency - np.abs(poles) / 2 / np.pi) / found.frequency_std),
            *((found.damping_ratio + poles.real / np.abs(poles)) / found.damping_std),
        ])  # fmt: skip
    rms = np.sqrt(np.mean(np.square(off)))
    assert 0.75 < rms < 1.3
    if stated:
        wrong = np.abs(found.residue - residues) / found.residue_std
        assert 0.4 < np.sqrt(np.mean(wrong**2)) < 2.0


def test_what_is_missed_beyond_the_noise_is_told():
    structure, poles, _ = damped()
    exact = measured(structure, MIXED, 0.01, 1)
    assert fit_residues(exact, near(poles)).lack.max() < 2e-3
    strange = exact.value * (1 + 0.1 * np.sin(3 * LINES))
    lack = fit_residues(Frf(LINES, strange, MIXED, FORCE, variance=exact.variance), near(poles)).lack
    assert lack.min() > 0.02


def test_residual_terms_stand_for_modes_outside_the_band():
    """Of three modes the middle one is in the band: more terms are taken than inertia and stiffness, and leave less."""
    structure, poles, residues = damped(2.0)
    f = np.abs(poles) / 2 / np.pi
    lines = np.linspace(1.3 * f[0], 0.85 * f[2], 200)
    frf = measured(structure, MIXED, 0.002, 3, lines)
    found, short = (fit_residues(frf, near(poles)[1:2], *more) for more in ((), (((-2, 0),),)))
    assert set(found.powers) > {-2, 0}
    assert short.powers == (-2, 0)
    assert found.error < 0.5 * short.error
    assert found.frequency[0] == pytest.approx(f[1], rel=2e-3)
    np.testing.assert_allclose(found.residue[0], residues[1], atol=0.05 * np.abs(residues[1]).max())


def test_too_few_lines_and_no_pole_are_told():
    structure, poles, _ = damped()
    few = measured(structure, MIXED, lines=np.linspace(3.0, 4.0, 4))
    with pytest.raises(EstimationError, match="4 lines are too few for 3 modes"):
        fit_residues(few, near(poles))
    with pytest.raises(EstimationError, match="at least one pole"):
        fit_residues(measured(structure, MIXED), np.zeros((0, 2)))
