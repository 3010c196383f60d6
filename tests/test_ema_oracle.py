"""sdypy-EMA as an oracle: where the modes are exactly known, its LSCF and LSFD and ours find the same."""

import numpy as np
import pytest

from labnnum.frf import Frf
from labnnum.identification import identify
from labnnum.identification_residues import fit_residues
from labnnum.recording import Channel

SENSORS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in range(3))
FORCE = (Channel("f", "force", "reference", "0", "x"),)
LINES = np.arange(5 * 8, 70 * 8 + 1) / 8
FREQUENCY, DAMPING = np.array([15.0, 32.0, 55.0]), np.array([0.01, 0.008, 0.012])
SHAPES = np.array([[1.0, 0.7, -0.5], [0.8, -0.9, 0.4], [0.9, 0.5, 1.0]])


@pytest.fixture
def exact():
    """FRFs of three modes without noise, their poles and residues (n_modes, n_out)."""
    w, s = 2 * np.pi * FREQUENCY, 2j * np.pi * LINES
    product = SHAPES * SHAPES[:, :1]
    modal = 1 / (s**2 + 2 * (DAMPING * w)[:, None] * s + (w**2)[:, None])
    poles = w * (-DAMPING + 1j * np.sqrt(1 - DAMPING**2))
    return (
        Frf(LINES, (s**2 * (product.T @ modal))[:, None], SENSORS, FORCE),
        poles,
        product / (2j * poles.imag[:, None]),
    )


@pytest.fixture
def peer(exact):
    """Poles, residues and reconstructed FRFs of sdypy-EMA, its poles picked nearest to the exact ones at order 12."""
    pytest.importorskip("sdypy.EMA", reason="sdypy-EMA is not installed (the extra `ema` or `test`)")
    from sdypy.EMA import Model

    frf, poles, _ = exact
    above = np.append(LINES, LINES[-1] + LINES[0] / 40)  # it drops the line at its upper limit
    rows = np.column_stack([frf.value[:, 0], frf.value[:, 0, -1]])
    m = Model(rows, above, lower=float(LINES[0]), upper=float(above[-1]), pol_order_high=12, frf_form="accelerance")
    m.get_poles(show_progress=False)
    found = np.asarray(m.all_poles[-1])
    found = np.where(np.isfinite(found), found, -1e12)
    m.pole_ind = np.array([[len(m.all_poles) - 1, int(np.argmin(np.abs(found - p)))] for p in poles])
    made, constants = m.get_constants(f_upper=float(LINES[-1]))
    made = made[:, np.argmin(np.abs(m.freq - LINES[0])) :][:, : LINES.size]
    return found[m.pole_ind[:, 1]], constants.T, made


def test_poles_and_residues_are_those_of_sdypy_ema(exact, peer):
    frf, poles, residues = exact
    found = identify(frf, 24)
    free = fit_residues(frf, np.column_stack([found.frequency, found.damping_ratio]))
    theirs, theirs_residues, _ = peer
    np.testing.assert_allclose(theirs, poles, rtol=1e-3)  # the oracle is right
    np.testing.assert_allclose(free.poles, theirs, rtol=1e-3)
    np.testing.assert_allclose(free.residue, theirs_residues, atol=0.02 * np.abs(residues).max())


def test_nothing_of_ours_is_further_from_the_truth(exact, peer):
    frf, poles, residues = exact
    found = identify(frf, 24)
    free = fit_residues(frf, np.column_stack([found.frequency, found.damping_ratio]))
    theirs, theirs_residues, made = peer
    for ours, other, true in (
        (free.poles.imag, theirs.imag, poles.imag),
        (free.poles.real, theirs.real, poles.real),
        (free.residue, theirs_residues, residues),
        (free.fitted, made, frf.value[:, 0]),
    ):
        assert np.linalg.norm(ours - true) <= np.linalg.norm(other - true)
