"""What a sound structure's parts differ by: columns against the structure with one part changed, the objective against
a dense covariance, and sizes of errors told from data that hold them."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import fit
from labnnum.diagnosis.objective import Problem
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.sharpen import LEAST, USUAL, sharpened
from labnnum.frf import Frf
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.structures import MatrixStructure
from labnnum.structures.quantities import modal

N = 5
LEFT, RIGHT = (Parameter(name, 1.0, 0.5, 1.5, std=0.1) for name in ("left", "right"))
OUTPUTS = tuple(Channel(f"a{n}", "acceleration", "response", node=str(n), direction="x") for n in range(1, N + 1))
FORCE = (Channel("force", "force", "reference", node="2", direction="x"),)


def springs(k):
    """Stiffness of a wall and masses in a row."""
    full = np.zeros((N + 1, N + 1))
    for i, one in enumerate(k):
        full[i : i + 2, i : i + 2] += one * np.array([[1, -1], [-1, 1]])
    return full


def chain(k=None, m=None):
    k = np.array([4e5, 3e5, 5e5, 4e5, 3e5]) if k is None else k
    m = np.array([1.0, 1.3, 0.8, 1.1, 0.9]) if m is None else m
    left, right = springs(np.where(np.arange(N) < 2, k, 0)), springs(np.where(np.arange(N) < 2, 0, k))
    dofs = tuple(f"{i}:x" for i in range(N + 1))
    nodes = {str(i): (0.1 * i, 0.0, 0.0) for i in range(N + 1)}
    return MatrixStructure(
        np.diag([1.0, *m]), left + right, dofs, dK={"left": left, "right": right}, parameters=(LEFT, RIGHT),
        damping=modal(0.01), clamped=("0",), positions=nodes,
        pairs=tuple((str(i), str(i + 1)) for i in range(N)),
    )  # fmt: skip


def engine(structure=None, outputs=OUTPUTS):
    return Engine(structure or chain(), outputs, FORCE, (10.0, 1570.0))


def lines(n=200):
    return np.asarray(2j * np.pi * np.linspace(15.0, 250.0, n), complex)


@pytest.mark.parametrize("kind", ["stiffness", "mass"])
@pytest.mark.parametrize("which", [0, 2, 4])
def test_a_part_changes_the_response_as_its_column_says(kind, which):
    """Of element and mass 3e-6 larger: what the column of shapes and the frequencies' own derivatives add."""
    made, step = engine(), 3e-6
    kinds = made.irregular.kinds
    assert kinds.count("stiffness") == kinds.count("loss") == kinds.count("mass") == N
    assert kinds.count("zone") == 2
    k, m = np.array([4e5, 3e5, 5e5, 4e5, 3e5]), np.array([1.0, 1.3, 0.8, 1.1, 0.9])
    if kind == "stiffness":
        a, b = made.site((), (), ()).mesh[which]
        k = k * (1 + step * (np.arange(N) == max(int(a), int(b)) - 1))
    else:
        m = m * (1 + step * (np.arange(N) == which))
    changed = engine(chain(k, m))
    s = lines()
    at = kinds.index(kind) + which
    common = np.eye(len(kinds))[:, [at]]
    point = made.start()
    r = made.response(point, (), s, jacobian=True, common=common)
    assert r.common is not None
    assert r.moved is not None
    assert r.jacobian is not None
    other = replace(changed.start(), log_zeta=point.log_zeta)
    real = (changed.response(other, (), s).value - r.value) / step
    first = point.theta.size
    told = r.common[0] + np.tensordot(r.moved[0], r.jacobian[first : first + N], 1)
    if kind == "mass":  # the size of each mode's own load and shape is left to what each row has of its own
        told = told - _own_sizes(made, point, s, which, m)
    np.testing.assert_allclose(told, real, atol=3e-3 * np.abs(real).max())


def _own_sizes(made, point, s, which, m):
    """Each band mode's response times its own share of the mass that was added."""
    state = made.state(point.theta)
    r = made.response(point, (), s, modal=True)
    share = state.shape[which] ** 2 * m[which]
    parts = state.out[made.band_modes].T[:, None, :, None] * np.moveaxis(r.modal, 0, 1)[None]
    return np.einsum("oimf,m->oif", parts, share[made.band_modes]) * r.lift


def test_what_is_marginalised_counts_as_a_dense_covariance():
    """r' (1 + B B' + C C')^-1 r with the prior of the frequencies beside it, by the inverse of the whole matrix."""
    made = engine(outputs=OUTPUTS[:2])
    s = lines(40)
    rng = np.random.default_rng(5)
    kinds = made.irregular.kinds
    scatter = replace(Scatter(), common=0.01 * rng.standard_normal((len(kinds), 4)))
    value = made.response(made.start(), (), s).value
    value = np.asarray(value * (1 + 0.02 * rng.standard_normal(value.shape)), complex)
    problem = Problem(made, Data(s, value, np.asarray(0.01 * np.abs(value))), (), scatter)
    x = made.start().vector()
    x[problem._offsets] = 0.002 * rng.standard_normal(N)
    r, b, c, _, moved = problem._parts(x, jacobian=False)
    rows, f = r.shape
    own = np.zeros((rows * f + N, rows * b.shape[2]))
    for i in range(rows):
        own[i * f : (i + 1) * f, i * b.shape[2] : (i + 1) * b.shape[2]] = b[i]
    spread = problem.std[problem._offsets]
    shared = np.vstack([c.reshape(rows * f, -1), -moved.T / spread[:, None]])
    left = np.concatenate([r.ravel(), -x[problem._offsets] / spread])
    dense = left @ np.linalg.solve(np.eye(left.size) + own @ own.T + shared @ shared.T, left)
    rest = np.ones(x.size, bool)
    rest[problem._offsets] = False
    prior = np.sum((((x - problem.mean) / problem.std) ** 2)[rest])
    assert problem.normal(x).objective == pytest.approx(dense + prior, rel=1e-9)
    assert problem.value(x, problem.normal(x)) == pytest.approx(dense + prior, rel=1e-9)


def test_a_slope_follows_what_is_marginalised():
    """Slope of the objective by central differences, where shapes are 30 % off: held, what is marginalised misleads."""
    made = engine(outputs=OUTPUTS[:3])
    s, rng = lines(60), np.random.default_rng(8)
    point = made.start()
    parts = made.response(point, (), s, modal=True)
    share = 0.3 * rng.standard_normal((3, N))
    value = parts.value + np.einsum("om,oimf->oif", share, parts.modal[None] * parts.lift[:, :, None])
    noise = 1 + 0.01 * rng.standard_normal(value.shape)
    scatter = replace(Scatter(), shape=0.3)
    problem = Problem(made, Data(s, value * noise, 0.002 * np.abs(value)), (), scatter)
    x = point.vector()
    x[problem._offsets] = 1e-3 * rng.standard_normal(N)
    slope = np.array([(problem.anew(x + h) - problem.anew(x - h)) / (2 * h.sum()) for h in 1e-7 * np.eye(x.size)])
    told, held = (-2 * problem.normal(x, moving=moving).gradient for moving in (True, False))
    scale = np.sqrt(np.diag(problem.normal(x, moving=True).hessian))
    shown = np.ones(x.size, bool)
    shown[problem._sizes] = False  # those are left out: they hardly move anything
    off = np.abs(np.stack([told, held]) - slope)[:, shown] / scale[shown]
    assert off[0].max() < 0.05 * off[1].max()


@pytest.mark.parametrize("gross", ["mass", "gain", "floor"])
def test_errors_get_the_size_that_the_data_support(gross):
    """FRFs of chains whose masses, gains or noise differ by all that a sound one may, or by next to nothing."""
    sizes = {"mass": 0.002, "gain": 0.001, "floor": 0.0003}
    most = Scatter()
    sizes[gross] = getattr(most, gross)
    told = {k: [] for k in sizes}
    for seed in range(6):
        rng = np.random.default_rng(seed)
        truth = engine(chain(m=np.array([1.0, 1.3, 0.8, 1.1, 0.9]) * (1 + sizes["mass"] * rng.standard_normal(N))))
        made = engine()
        s = lines()
        value = truth.response(truth.start(), (), s).value
        value = value * (1 + sizes["gain"] * rng.standard_normal((N, 1, 1)))
        noise = rng.standard_normal((2, *value.shape)) / np.sqrt(2)
        value = np.asarray(value * (1 + sizes["floor"] * (noise[0] + 1j * noise[1])), complex)
        noise = 1e-5 * np.abs(value)
        frf = Frf(np.imag(s) / 2 / np.pi, value, OUTPUTS, FORCE, None, noise**2, 10.0, "test")
        data = Data(s, value, noise).with_floor(most.floor)
        base = fit(made, data, (), most, made.start().vector(), steps=40)
        sharp = sharpened(made, frf, base, most, data)
        for k in told:
            told[k].append(getattr(sharp, k) / getattr(most, k))
    mean = {k: np.mean(v) for k, v in told.items()}
    assert mean[gross] > 0.75
    for k in set(told) - {gross}:
        assert LEAST <= mean[k] < USUAL[k]


def test_the_spread_of_shapes_is_that_of_structures_with_parts_of_their_own():
    """Against modes solved anew with each element and mass drawn, 1 % and 2 % about the model's."""
    rng = np.random.default_rng(3)
    one = engine()
    b = one.band_modes
    rows = np.array([one.participation(f"{i}:x", one.theta0) for i in (1, 3, 5)])
    k, m = np.array([4e5, 3e5, 5e5, 4e5, 3e5]), np.array([1.0, 1.3, 0.8, 1.1, 0.9])
    nominal = one.state(one.theta0).shape
    moved = []
    for _ in range(400):
        other = engine(chain(k * (1 + 0.01 * rng.standard_normal(N)), m * (1 + 0.02 * rng.standard_normal(N))))
        shape = other.state(one.theta0).shape
        shape = shape * np.sign(np.sum(shape * nominal, axis=0))
        moved.append(rows @ (shape - nominal)[:, b])
    drawn = np.std(moved, axis=0)
    np.testing.assert_allclose(one.shape_spread(rows, 0.01, 0.02), drawn, rtol=0.15, atol=0.02 * drawn.max())
