import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from labnnum.errors import EstimationError
from labnnum.updating.compiled import compiled
from labnnum.updating.fitting import (
    _loo_objective,
    descend_gamma,
    fit_printed,
    fit_tuned,
    gamma_gradient,
    principal_components,
)
from labnnum.updating.kernels import KERNELS, squared_distances, tail_terms
from labnnum.updating.network import RbfNetwork

RNG = np.random.default_rng(3)
X = RNG.random((90, 4))
Y = np.column_stack([np.sin(3 * X[:, 0]) + X[:, 1] ** 2, 5 + X[:, 2] * X[:, 3]])


def test_the_printed_network_passes_through_its_samples():
    net = fit_printed(X, Y)
    assert np.allclose(net(X), Y, rtol=1e-6)
    assert net.gamma == 1.0
    assert net.degree == -1


def test_the_printed_network_is_equation_4_37_written_out():
    net = fit_printed(X, Y, gamma=0.7)
    unit = (X - X.min(0)) / np.ptp(X, axis=0)
    sigma = 0.7 * unit.std(axis=0)
    h = np.exp(-np.sqrt(((sigma * (unit[:, None] - unit[None])) ** 2).sum(axis=-1)))
    w = np.linalg.solve(h, (Y - Y.mean(0)) / Y.std(0))
    new = RNG.random((7, 4))
    u = (new - X.min(0)) / np.ptp(X, axis=0)
    hidden = np.exp(-np.sqrt(((sigma * (u[:, None] - unit[None])) ** 2).sum(axis=-1)))
    assert np.allclose(net(new), Y.mean(0) + Y.std(0) * (hidden @ w), rtol=1e-7)


def test_features_that_never_vary_get_no_say():
    dead = np.column_stack([X, np.full(len(X), 3.0)])
    assert np.allclose(fit_printed(dead, Y)(dead + np.array([0, 0, 0, 0, 9])), fit_printed(X, Y)(X))


def test_weights_count_after_normalisation():
    halved = fit_printed(X, Y, weights=np.array([1, 1, 0.5, 1]))
    assert np.allclose(halved.projection, fit_printed(X, Y).projection * [[1], [1], [0.5], [1]])


def test_the_gradient_to_gamma_is_exact():
    z = X * X.std(axis=0)
    inner = np.sqrt(squared_distances(z[30:], z[30:]))
    outer = np.sqrt(squared_distances(z[:30], z[30:]))
    error, slope = gamma_gradient(1.3, inner, outer, Y[30:], Y[:30])
    up = gamma_gradient(1.3 + 1e-5, inner, outer, Y[30:], Y[:30])[0]
    down = gamma_gradient(1.3 - 1e-5, inner, outer, Y[30:], Y[:30])[0]
    assert slope == pytest.approx((up - down) / 2e-5, rel=1e-4)
    assert error > 0


def test_descent_lowers_the_held_out_error():
    z = X * X.std(axis=0)
    gamma = descend_gamma(z, Y, start=3.0)
    order = np.random.default_rng(0).permutation(len(z))
    held, kept = order[:22], order[22:]
    parts = (np.sqrt(squared_distances(z[kept], z[kept])), np.sqrt(squared_distances(z[held], z[kept])))
    assert gamma_gradient(gamma, *parts, Y[kept], Y[held])[0] <= gamma_gradient(3.0, *parts, Y[kept], Y[held])[0]


def test_leave_one_out_equals_leaving_one_out():
    z, terms = X[:25] * 2, tail_terms(X[:25] * 2, 1)
    log_scales = np.append(np.zeros(4), np.log(1e-6))
    value, _ = _loo_objective(log_scales, z, Y[:25], terms, KERNELS["matern52"])
    errors = []
    for i in range(25):
        keep = np.arange(25) != i
        kernel = KERNELS["matern52"](squared_distances(z[keep], z[keep]))[0] + 1e-6 * np.eye(24)
        bordered = np.block([[kernel, terms[keep]], [terms[keep].T, np.zeros((5, 5))]])
        solved = np.linalg.solve(bordered, np.vstack([Y[:25][keep], np.zeros((5, 2))]))
        row = KERNELS["matern52"](squared_distances(z[i : i + 1], z[keep]))[0]
        errors.append(Y[i] - (row @ solved[:24] + terms[i] @ solved[24:])[0])
    assert value == pytest.approx(np.log((np.array(errors) ** 2).mean(axis=0)).mean(), abs=1e-6)


@pytest.mark.parametrize("kernel", ["gaussian", "matern52", "inverse_multiquadric"])
def test_the_gradient_of_leave_one_out_is_exact(kernel):
    z, terms = X[:30] * 2, tail_terms(X[:30] * 2, 1)
    at = np.array([0.1, -0.2, 0.3, 0.0, np.log(1e-4)])
    _, slope = _loo_objective(at, z, Y[:30], terms, KERNELS[kernel])
    for k in range(5):
        step = 1e-5 * np.eye(5)[k]
        up = _loo_objective(at + step, z, Y[:30], terms, KERNELS[kernel])[0]
        down = _loo_objective(at - step, z, Y[:30], terms, KERNELS[kernel])[0]
        assert slope[k] == pytest.approx((up - down) / 2e-5, rel=1e-3, abs=1e-6)


def test_a_tuned_network_beats_scipys_with_one_length():
    new = RNG.random((200, 4))
    truth = np.column_stack([np.sin(3 * new[:, 0]) + new[:, 1] ** 2, 5 + new[:, 2] * new[:, 3]])
    ours = np.abs(fit_tuned(X, Y)(new) - truth).mean()
    theirs = np.abs(RBFInterpolator(X, Y, kernel="thin_plate_spline")(new) - truth).mean()
    assert ours < 0.5 * theirs


def test_fewer_centres_is_least_squares_with_a_ridge_that_does_no_harm():
    rng = np.random.default_rng(0)
    y = Y + 0.01 * rng.standard_normal(Y.shape)
    net = fit_tuned(X, y, centres=30, degree=1)
    assert net.centres.shape == (30, 4)

    def design(x):
        z = net.inputs(x)
        return np.hstack([KERNELS["gaussian"](squared_distances(z, net.centres))[0], tail_terms(z, 1)])

    weights = np.linalg.lstsq(design(X), (y - y.mean(0)) / y.std(0), rcond=None)[0]
    new = rng.random((300, 4))
    truth = np.column_stack([np.sin(3 * new[:, 0]) + new[:, 1] ** 2, 5 + new[:, 2] * new[:, 3]])
    plain = y.mean(0) + y.std(0) * (design(new) @ weights)
    assert np.sqrt(((net(new) - truth) ** 2).mean()) < 1.05 * np.sqrt(((plain - truth) ** 2).mean())
    assert np.sqrt(((net(X) - y) ** 2).mean()) < 0.02


def test_the_residual_of_least_squares_predicts_the_error_on_new_data():
    rng = np.random.default_rng(5)
    x = rng.random((2000, 3))
    y = (x[:, :1] - x[:, 1:2] * x[:, 2:]) + 0.05 * rng.standard_normal((2000, 1))
    net = fit_tuned(x, y, centres=60)
    assert np.sqrt(net.residual[0, 0]) == pytest.approx(0.05, rel=0.05)


@pytest.mark.parametrize("kind", ["printed", "tuned"])
def test_the_jacobian_is_exact(kind):
    net = fit_printed(X, Y) if kind == "printed" else fit_tuned(X, Y)
    at = np.full(4, 0.47)
    step = 1e-4  # rounding and truncation of the difference are both near 1e-7 here
    numeric = np.array([(net(at + step * e) - net(at - step * e)) / (2 * step) for e in np.eye(4)]).T
    assert np.allclose(net.jacobian(at), numeric, rtol=1e-4, atol=1e-6)


def test_components_are_uncorrelated_and_of_unit_variance():
    x = np.hstack([X, X @ RNG.random((4, 3)), np.full((90, 1), 2.0)])
    mean, rotation = principal_components(x)
    z = (x - mean) @ rotation
    assert z.shape == (90, 4)
    assert np.allclose(z.T @ z / 90, np.eye(4), atol=1e-8)


def test_a_network_survives_its_arrays():
    net = fit_tuned(X, Y)
    again = RbfNetwork(**net.arrays())
    assert np.array_equal(again(X), net(X))


def test_what_is_refused():
    with pytest.raises(EstimationError, match="at least 4"):
        fit_tuned(X[:3], Y[:3])
    bad = X.copy()
    bad[5, 1] = np.nan
    with pytest.raises(EstimationError, match="sample 5"):
        fit_tuned(bad, Y)
    with pytest.raises(EstimationError, match="pairs"):
        fit_tuned(X, Y[:50])
    with pytest.raises(EstimationError, match="no feature varies"):
        fit_printed(np.ones((50, 3)), Y[:50])
    with pytest.raises(EstimationError, match="no feature varies"):
        fit_tuned(np.ones((50, 3)), Y[:50])
    with pytest.raises(EstimationError, match="takes 4 features, not 3"):
        fit_tuned(X, Y)(X[:, :3])


@pytest.mark.parametrize("degree", [-1, 0, 1, 2])
def test_the_compiled_network_answers_the_same(degree):
    net = fit_tuned(X, Y, degree=degree)
    assert net.degree == degree
    answer = compiled(net)
    rounding = np.finfo(float).eps * np.abs(net.scale) * np.abs(net.weights).sum(axis=0)  # of weights that cancel
    for row in X[:3] + 0.01:
        assert np.all(np.abs(answer(row) - net(row)) <= 2 * rounding + 1e-12 * np.abs(net(row)))
    with pytest.raises(EstimationError, match="only a gaussian kernel"):
        compiled(fit_printed(X, Y))


@pytest.mark.parametrize("kernel", KERNELS)
def test_many_at_once_equal_one_after_the_other(kernel):
    net = fit_tuned(X, Y, kernel=kernel)
    many = RNG.random((600, 4))
    assert np.allclose(net(many), [net(row) for row in many], rtol=1e-5)
