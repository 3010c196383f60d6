"""The tool box of chapter 2 against its own identities and exact answers."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh

from labnnum.correlation import (
    best_subspaces,
    effective_independence,
    expand_by_matrices,
    expand_by_modes,
    frac,
    guyan,
    mac,
    mass_mac,
    modal_scale_factor,
    pairs,
    place_by_guyan,
    real_modes,
    serep,
)
from labnnum.errors import ModelError
from labnnum.response import modes
from labnnum.structures.examples import dissertation_beam, yang_brown

S = yang_brown()
M, K = S.matrices(S.nominal).M, S.matrices(S.nominal).K
OMEGA2, PHI = eigh(K, M)


@given(seed=st.integers(0, 1000), factor=st.complex_numbers(min_magnitude=0.1, max_magnitude=10))
@settings(max_examples=25, deadline=None)
def test_mac_is_one_for_proportional_shapes_and_never_more(seed, factor):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(6, 3)) + 1j * rng.normal(size=(6, 3))
    np.testing.assert_allclose(np.diag(mac(u, factor * u)), 1.0)
    assert (mac(u, rng.normal(size=(6, 4))) <= 1 + 1e-12).all()


def test_mass_mac_of_modes_is_the_identity():
    np.testing.assert_allclose(mass_mac(PHI, PHI, M), np.eye(15), atol=1e-12)
    assert mac(PHI, PHI)[0, 1] >= 0
    with pytest.raises(ModelError, match="15 and 14 degrees"):
        mac(PHI, PHI[1:])


def test_shapes_of_zero_have_no_mac():
    assert mac(np.zeros((3, 1)), np.ones((3, 1)))[0, 0] == 0


def test_pairs_are_one_to_one():
    order = np.random.default_rng(1).permutation(15)
    found = pairs(mass_mac(PHI[:, order], PHI, M), 0.9)
    assert found == tuple((i, int(j)) for i, j in enumerate(order))
    assert pairs([[0.9, 0.7], [0.8, 0.1]], 0.5) == ((0, 1), (1, 0))
    assert pairs([[0.9, 0.2], [0.3, 0.1]], 0.5) == ((0, 0),)


def test_modal_scale_factor_restores_size_and_sign():
    factors = np.array([-2.0, 0.5, 3.0])
    measured = PHI[:, :3] * factors
    np.testing.assert_allclose(measured * modal_scale_factor(measured, PHI[:, :3]), PHI[:, :3])


def test_frac():
    h = np.exp(1j * np.linspace(0, 9, 50)) * np.linspace(1, 2, 50)
    np.testing.assert_allclose(frac(h, (2 - 1j) * h), 1.0)
    assert frac(h, h.conj()) < 0.5
    assert frac(np.zeros(3), np.ones(3)) == 0


def test_real_modes_of_nearly_real_ones():
    """Turned by any phase a real shape comes back; small imaginary parts change it at second order."""
    turned = PHI[:, :4] * np.exp(1j * np.array([0.3, 1.2, -2.0, 3.0]))
    np.testing.assert_allclose(np.abs(real_modes(turned)), np.abs(PHI[:, :4]), atol=1e-12)
    mixed = PHI[:, :4] @ (np.eye(4) + 0.01j * np.random.default_rng(2).normal(size=(4, 4)))
    np.testing.assert_allclose(np.diag(mac(real_modes(mixed), PHI[:, :4])), 1.0, atol=1e-3)


MASTERS = [0, 2, 4, 5, 7, 9]


def test_expansion_by_matrices_is_exact_with_the_true_model():
    omega = np.sqrt(OMEGA2[:4])
    found = expand_by_matrices(PHI[MASTERS, :4], omega, M, K, MASTERS)
    np.testing.assert_allclose(found, PHI[:, :4], rtol=1e-6, atol=1e-9)


def test_expansion_by_modes_is_exact_with_the_true_model_and_smooths():
    found = expand_by_modes(PHI[MASTERS, :4], PHI[:, :5], MASTERS)
    np.testing.assert_allclose(found.shapes, PHI[:, :4], atol=1e-9)
    np.testing.assert_allclose(found.weights, np.eye(5)[:, :4], atol=1e-9)
    noise = 0.1 * np.random.default_rng(3).normal(size=(6, 4))
    smoothed = expand_by_modes(PHI[MASTERS, :4] + noise, PHI[:, :3], MASTERS).shapes[MASTERS]
    residual = PHI[MASTERS, :4] + noise - smoothed
    np.testing.assert_allclose(PHI[np.ix_(MASTERS, range(3))].T @ residual, 0.0, atol=1e-9)


def test_guyan_is_exact_at_zero_frequency_and_never_softer():
    r = guyan(M, K, MASTERS)
    np.testing.assert_allclose(np.linalg.inv(r.stiffness), np.linalg.inv(K)[np.ix_(MASTERS, MASTERS)], rtol=1e-9)
    reduced = eigh(r.stiffness, r.mass, eigvals_only=True)
    assert (reduced >= OMEGA2[:6] * (1 - 1e-12)).all()
    with pytest.raises(ModelError, match="move freely"):
        guyan(np.eye(3), np.diag([1.0, 0.0, 0.0]), [0])
    with pytest.raises(ModelError, match="must be different coordinates"):
        guyan(M, K, [0, 0])


def test_serep_keeps_its_modes_exactly():
    r = serep(M, K, PHI[:, :6], MASTERS)
    np.testing.assert_allclose(eigh(r.stiffness, r.mass, eigvals_only=True), OMEGA2[:6], rtol=1e-8)
    np.testing.assert_allclose(r.transformation @ PHI[MASTERS, :6], PHI[:, :6], atol=1e-8)
    with pytest.raises(ModelError, match="2 masters cannot tell 3 modes"):
        serep(M, K, PHI[:, :3], [0, 1])


def test_guyan_placement_avoids_light_stiff_coordinates():
    chosen = place_by_guyan(M, K, 5)
    assert len(chosen) == 5
    assert all(c < 10 for c in chosen)  # the rung masses 10 to 14 are twenty times lighter
    assert set(place_by_guyan(M, K, 3, candidates=[0, 5, 10, 12])) <= {0, 5, 10, 12}
    with pytest.raises(ModelError, match="9 transducers"):
        place_by_guyan(M, K, 9, candidates=[0, 1])


def test_effective_independence_is_near_the_best_determinant():
    s = dissertation_beam()
    phi = modes(s, s.nominal, 3).shape[::2]
    chosen, share = effective_independence(phi, 3)
    np.testing.assert_allclose(share, 1.0)
    found = abs(np.linalg.det(phi[list(chosen)]))
    best = max(abs(np.linalg.det(phi[list(c)])) for c in combinations(range(len(phi)), 3))
    assert found > 0.6 * best
    with pytest.raises(ModelError, match="2 transducers cannot tell 3"):
        effective_independence(phi, 2)


def test_effective_independence_shares_add_up_to_the_rank():
    chosen, share = effective_independence(PHI[:, :4], 9)
    assert share.sum() == pytest.approx(4)
    assert list(chosen) == sorted(chosen)
    assert set(effective_independence(PHI[:, :2], 3, candidates=[1, 3, 6, 8])[0]) <= {1, 3, 6, 8}


def test_best_subspaces_find_the_parameters_in_error():
    rng = np.random.default_rng(5)
    s = rng.normal(size=(40, 8)) + 1j * rng.normal(size=(40, 8))
    b = s[:, [6, 2]] @ [1.0, -0.6]
    found = best_subspaces(s, b, 4)
    assert found[0].columns == (6,)
    assert set(found[1].columns) == {2, 6}
    assert found[1].error < 1e-12
    np.testing.assert_allclose(found[1].coefficients, [1.0, -0.6])
    errors = [f.error for f in found]
    assert (np.diff(errors) < 1e-12).all()
    with pytest.raises(ModelError, match="no error to locate"):
        best_subspaces(s, 0 * b)
