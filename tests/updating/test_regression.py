"""Least squares in blocks: what plain least squares gives, and what it loses where columns are nearly alike."""

import numpy as np
import pytest

from labnnum.updating.kernels import kernel_values, squared_distances, tail_terms
from labnnum.updating.regression import regress


def problem(seed: int, length: float, noise: float, n: int = 2000):
    rng = np.random.default_rng(seed)
    z = rng.uniform(-2, 2, (2 * n, 4))
    f = np.column_stack([np.sin(z[:, 0]) + 0.3 * z[:, 1] * z[:, 2], np.exp(0.3 * z[:, 3])])
    f = (f - f.mean(axis=0)) / f.std(axis=0)
    u = z / length
    centres = u[rng.choice(n, 150, replace=False)]
    return u, f, f + noise * rng.standard_normal(f.shape), centres


def fitted(u, t, centres, n, block=4096):
    def body(rows):
        return kernel_values("gaussian", squared_distances(rows, centres))

    found = regress(lambda s: tail_terms(u[:n][s], 2), lambda s: body(u[:n][s]), t[:n], block)
    return found, tail_terms(u, 2) @ found.head + body(u) @ found.body


def test_columns_that_differ_give_plain_least_squares():
    rng = np.random.default_rng(0)
    a, t = rng.standard_normal((300, 12)), rng.standard_normal((300, 2)) * 1e-6
    t += a @ rng.standard_normal((12, 2))
    found = regress(lambda s: a[s, :4], lambda s: a[s, 4:], t)
    assert np.allclose(np.vstack([found.head, found.body]), np.linalg.lstsq(a, t, rcond=None)[0], rtol=1e-5, atol=1e-6)
    again = regress(lambda s: a[s, :4], lambda s: a[s, 4:], t, 37)
    assert np.allclose(found.body, again.body, rtol=1e-9)
    assert np.allclose(found.errors, again.errors, rtol=1e-5, atol=1e-12)


def test_its_errors_are_those_of_leaving_one_out():
    rng = np.random.default_rng(1)
    a, t = rng.standard_normal((40, 10)), rng.standard_normal((40, 1))
    found = regress(lambda s: a[s, :2], lambda s: a[s, 2:], t)
    rest = a[:, 2:] - a[:, :2] @ np.linalg.lstsq(a[:, :2], a[:, 2:], rcond=None)[0]
    ridge = np.diag(np.r_[0, 0, found.ridge[0] * np.sqrt((rest**2).sum(axis=0))])
    for i in range(40):
        keep = np.arange(40) != i
        rows = np.vstack([a[keep], ridge @ np.hstack([np.zeros((10, 2)), np.eye(10)[:, 2:]])])
        w = np.linalg.lstsq(rows, np.vstack([t[keep], np.zeros((10, 1))]), rcond=None)[0]
        assert found.errors[i] == pytest.approx(t[i] - a[i] @ w, rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_wide_kernels_lose_little(seed, noise):
    n, left = 2000, {}
    for length in (2.0, 20.0):
        u, f, t, centres = problem(seed, length, noise)
        found, answer = fitted(u, t, centres, n)
        left[length] = np.sqrt(((answer - f)[n:] ** 2).mean())
        assert np.abs(found.body).max() * np.finfo(float).eps < 1e-3  # else rounding shows in the answer
    assert left[20.0] < (0.002 if noise == 0.0 else 0.03)
    assert left[2.0] < (0.01 if noise == 0.0 else 0.03)


@pytest.mark.parametrize("noise", [0.1])
def test_noise_does_not_cost_more_than_it_must(noise):
    n = 2000
    for seed in range(3):
        u, f, t, centres = problem(seed, 5.0, noise)
        found, answer = fitted(u, t, centres, n)
        plain = np.hstack([tail_terms(u, 2), kernel_values("gaussian", squared_distances(u, centres))])
        theirs = plain @ np.linalg.lstsq(plain[:n], t[:n], rcond=1e-12)[0]
        ours, unridged = (np.sqrt(((a - f)[n:] ** 2).mean()) for a in (answer, theirs))
        assert ours < 0.8 * unridged
        held_out = np.sqrt(((answer - t)[n:] ** 2).mean(axis=0))
        assert np.allclose(np.sqrt((found.errors**2).mean(axis=0)), held_out, rtol=0.1)


def test_columns_that_are_head_or_twice_there_do_no_harm():
    rng = np.random.default_rng(2)
    a = rng.standard_normal((200, 3))
    t = a @ np.ones((3, 1)) + 0.01 * rng.standard_normal((200, 1))
    body = np.hstack([a[:, :1], a[:, 2:], a[:, 2:]])
    found = regress(lambda s: a[s, :2], lambda s: body[s], t)
    assert np.allclose(a[:, :2] @ found.head + body @ found.body, a @ np.ones((3, 1)), atol=0.01)
    assert np.abs(found.body).max() < 10
