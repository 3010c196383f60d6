import numpy as np
import pytest

from labnnum.parameters import Parameter, truncated_samples
from labnnum.response import frf, frf_sensitivity
from labnnum.structures.beam import Beam
from labnnum.structures.chain import Chain, Link
from labnnum.structures.examples import EXAMPLES, force_at, motion_of
from labnnum.structures.quantities import modal, structural
from labnnum.structures.section import Section
from labnnum.updating.batch import FrfBatch
from labnnum.updating.elimination import Elimination
from labnnum.updating.engines import EliminationEngine, ModalEngine
from labnnum.updating.family import MatrixFamily

ENGINES = {name: ModalEngine if name == "frame" else EliminationEngine for name in EXAMPLES}
LINES = 60


def lines(example):
    low, high = min(b.low for b in example.bands), max(b.high for b in example.bands)
    return np.linspace(low, high, LINES) * 1.0001


def draw(structure, n, seed=0):
    return truncated_samples(structure.parameters, np.random.default_rng(seed).random((n, len(structure.parameters))))


@pytest.mark.parametrize("name", EXAMPLES)
def test_many_sets_at_once_equal_one_after_the_other(name):
    example = EXAMPLES[name]()
    structure, f = example.structure, lines(example)
    batch = FrfBatch.of(structure, f, example.outputs, example.inputs)
    assert isinstance(batch.engine, ENGINES[name])
    theta = draw(structure, 3)
    value, slope = batch.sensitivity(theta)
    assert np.allclose(value, batch.frf(theta), rtol=1e-12)
    tolerance = 3e-5 if name == "frame" else 1e-8
    for t, h, dh in zip(theta, value, slope, strict=True):
        exact, exact_slope = frf_sensitivity(structure, t, f, example.outputs, example.inputs)
        assert np.abs(h - exact).max() < tolerance * np.abs(exact).max()
        for mine, theirs in zip(dh, exact_slope, strict=True):
            assert np.abs(mine - theirs).max() < tolerance * np.abs(theirs).max()


def oscillators(n, damping):
    links = [Link(str(i), str(i + 1), "k" if i == 2 else 100.0) for i in range(1, n)]
    links.append(Link("1", "ground", 50.0))
    masses = {str(i): "m" if i == 1 else 1.0 for i in range(1, n + 1)}
    parameters = (Parameter("k", 100.0, 60.0, 140.0), Parameter("m", 1.0, 0.5, 1.5))
    return Chain(masses, tuple(links), parameters, damping)


@pytest.mark.parametrize(
    ("structure", "engine"),
    [
        (oscillators(6, structural(0.02)), EliminationEngine),
        (oscillators(30, structural(0.02)), ModalEngine),
        (oscillators(30, modal(0.01)), type(None)),
    ],
)
def test_the_way_is_chosen_by_the_structure(structure, engine):
    f = np.linspace(0.1, 2.0, 40)
    args = (f, (motion_of("3", "velocity"),), (force_at("2"),))
    batch = FrfBatch.of(structure, *args)
    assert isinstance(batch.engine, engine)
    theta = draw(structure, 2)
    for t, h in zip(theta, batch.frf(theta), strict=True):
        assert np.allclose(h, frf(structure, t, *args), rtol=1e-6)


def test_places_that_move_are_left_to_the_slow_way():
    section = Section(E=7e10, rho=2700.0, width=0.03, height=0.005)
    beam = Beam(
        "L", section, n_elements=4, supports_at={"1": "clamped"}, points={"p": 0.2},
        parameters=(Parameter("L", 0.5, 0.45, 0.55),),
    )  # fmt: skip
    batch = FrfBatch.of(beam, [10.0, 30.0], (motion_of("p", direction="z"),), (force_at("5", "z"),))
    assert batch.engine is None
    assert batch.frf([[0.5], [0.52]]).shape == (2, 1, 1, 2)


def test_entries_are_polynomials_to_rounding():
    structure = EXAMPLES["frame"]().structure
    family = MatrixFamily.of(structure)
    assert family is not None
    for theta in draw(structure, 3, seed=5):
        exact = structure.matrices(theta)
        for mine, theirs in zip(family.dense(theta[None]), (exact.M, exact.C, exact.K, exact.D), strict=True):
            assert np.abs(mine[0] - theirs).max() <= 1e-11 * np.abs(theirs).max()


def test_slopes_of_the_terms_are_those_of_the_matrices():
    structure = EXAMPLES["frame"]().structure
    family = MatrixFamily.of(structure)
    assert family is not None
    theta = draw(structure, 1)[0]
    slopes = family.term_slopes(theta[None])[:, 0]
    for slope, exact in zip(slopes, structure.derivatives(theta), strict=True):
        mine = family.filled(2, slope @ family.coefficients[2])
        assert np.abs(mine - exact.K).max() <= 1e-9 * max(np.abs(exact.K).max(), 1e-300)


def test_many_parameters_take_pairs_only():
    parameters = tuple(Parameter(f"k{i}", 100.0, 50.0, 150.0) for i in range(12))
    links = (*(Link(str(i), str(i + 1), f"k{i}") for i in range(11)), Link("0", "ground", "k11"))
    structure = Chain({str(i): 1.0 for i in range(12)}, links, parameters)
    family = MatrixFamily.of(structure)
    assert family is not None
    assert len(family.powers) == 13
    assert np.allclose(family.dense(structure.nominal[None])[2][0], structure.matrices(structure.nominal).K)


def test_what_is_no_polynomial_has_no_family():
    class Kinked(Chain):
        def matrices(self, theta):
            m = super().matrices(theta)
            m.K[0, 0] += max(theta[0] - 100.0, 0.0)
            return m

    base = oscillators(3, structural(0.0))
    assert MatrixFamily.of(Kinked(base.masses, base.links, base.parameters)) is None


def test_elimination_solves():
    rng = np.random.default_rng(0)
    a = np.diag(rng.random(6) + 3) + 0j
    for i, j in [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (0, 5), (1, 4)]:
        a[i, j] = a[j, i] = rng.random() + 1j * rng.random()
    entries = frozenset((i, j) for i in range(6) for j in range(i + 1) if a[i, j] != 0)
    plan = Elimination.of(6, entries, frozenset({2}))
    assert plan.order[-1] == 2
    x = plan.factor(lambda i, j: np.array([[a[i, j]]])).solve({3: 2.0, 0: 1.0}, frozenset(range(6)))
    load = np.array([1.0, 0, 0, 2.0, 0, 0])
    assert np.allclose([x[i][0, 0] for i in range(6)], np.linalg.solve(a, load))
