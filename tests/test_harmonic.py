"""Harmonic balance: the linear limit, the dissertation's Duffing oscillator, folds, energies, what is refused."""

import numpy as np
import pytest

from labnnum.errors import EstimationError, ModelError
from labnnum.harmonic import HarmonicBalance
from labnnum.nonlinear import Element
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.response import frf
from labnnum.structures.chain import Chain, Link
from labnnum.structures.duffing import Duffing
from labnnum.structures.modal import ModalStructure, Mode
from labnnum.structures.quantities import Damping
from tests.steady import Truth

TURN = 2 * np.pi
ONE = np.ones(1)


def single(mass=1.0, damping=0.05, stiffness=1.0):
    return Chain({"1": mass}, (Link("1", "ground", stiffness, damping),))


def balance(law, p, force=0.1, harmonics=5, **values):
    return HarmonicBalance(single(**values), "1:x", force, elements=[Element(law, ONE, p)], harmonics=harmonics)


def duffing(epsilon, harmonics=3):
    """The dissertation's oscillator, x'' + 2 eps mu x' + x + eps alpha x^3 = eps K cos(omega t)."""
    return balance("cubic", (1.5 * epsilon,), 0.6 * epsilon, harmonics, damping=0.5 * epsilon)


def chain(base=""):
    links = (Link("1", "ground", 1000.0), Link("1", "2", 800.0), Link("2", "3", 600.0))
    damping = Damping("structural", eta=0.02)
    return Chain({"1": 1.0, "2": 1.2, "3": 0.8}, links, damping=damping, base=base)


@pytest.mark.parametrize("harmonics", [1, 4])
def test_without_laws_it_is_the_receptance(harmonics):
    """Structural damping is not smoothed into dashpots, and a law of no strength changes nothing."""
    structure, f = chain(), np.array([1.7, 3.9, 5.1, 9.0])
    outputs = [Channel(f"u{i}", "displacement", "response", str(i), "x") for i in (1, 2, 3)]
    drive = Channel("f", "force", "reference", "2", "x")
    exact = frf(structure, structure.nominal, f, outputs, [drive])[:, 0]
    for elements in ((), [Element("cubic", np.array([0.0, -1.0, 1.0]), (0.0,))]):
        found = HarmonicBalance(structure, "2:x", 7.0, ("1:x", "2:x", "3:x"), elements=elements, harmonics=harmonics)
        for i, one in enumerate(f):
            np.testing.assert_allclose(found.solve(one).harmonics[:, 1], 7.0 * exact[:, i], rtol=1e-9)
            np.testing.assert_allclose(found.solve(one).harmonics[:, 2:], 0.0, atol=1e-15)


def test_dashpots_that_couple_modes_are_no_matter():
    links = (Link("1", "ground", 1000.0, 1.0), Link("1", "2", 800.0), Link("2", "3", 600.0, 9.0))
    structure = Chain({"1": 1.0, "2": 1.2, "3": 0.8}, links)
    output = Channel("u", "displacement", "response", "3", "x")
    exact = frf(structure, structure.nominal, np.array([3.0]), [output], [Channel("f", "force", "reference", "1", "x")])
    found = HarmonicBalance(structure, "1:x", 2.0, ("3:x",), harmonics=2).solve(3.0)
    np.testing.assert_allclose(found.harmonics[0, 1], 2.0 * exact[0, 0, 0], rtol=1e-9)
    assert found.stable


def test_a_moving_base_gives_absolute_motions():
    structure = chain(base="x")
    output = Channel("u", "displacement", "response", "3", "x")
    base = Channel("b", "acceleration", "base", "", "x")
    exact = frf(structure, structure.nominal, np.array([3.0]), [output], [base])[0, 0, 0]
    found = HarmonicBalance(structure, "base", 2.0, ("3:x",), harmonics=2).solve(3.0)
    np.testing.assert_allclose(found.harmonics[0, 1], 2.0 * exact, rtol=1e-9)
    assert len(HarmonicBalance(structure, "base", 2.0, harmonics=2).outputs) == 3


def test_a_free_body_keeps_a_law_without_a_mean():
    """Two masses that nothing holds, and a cubic spring between them: their centre moves as the force has it."""
    pair = Chain({"1": 1.0, "2": 1.0}, (Link("1", "2", 100.0, 1.0),))
    law = Element("cubic", np.array([-1.0, 1.0]), (1e4,))
    found = HarmonicBalance(pair, "1:x", 5.0, ("1:x", "2:x"), elements=[law], harmonics=5).solve(2.0)
    np.testing.assert_allclose(found.harmonics[:, 1].mean(), -5.0 / (2.0 * (2.0 * TURN) ** 2), rtol=1e-9)
    assert abs(found.harmonics[:, 3]).max() > 1e-3 * abs(found.harmonics[:, 1]).max()
    np.testing.assert_allclose(found.harmonics[:, 0], 0.0, atol=1e-9)


def test_a_residual_flexibility_is_a_spring_in_series():
    """A cubic spring at a place with residual flexibility: the mode and a law behind a spring, written out as such."""
    law = Element("cubic", np.array([1.0, 2e-3]), (3e5,))
    modal = ModalStructure((Mode(5.0, 0.03, {"1:x": 1.0}),), {"1:x": 2e-3})
    found = HarmonicBalance(modal, "1:x", 30.0, elements=[law], harmonics=7).solve(4.0)
    w, k = 4.0 * TURN, (5.0 * TURN) ** 2

    def mode(force):  # the mode's motion under forces by harmonics, mean first
        n = np.arange(force.size)
        return force / (k - (n * w) ** 2 + 2j * 0.03 * 5.0 * TURN * n * w)

    law_force = found.force[0]
    total = -law_force + np.eye(1, law_force.size, 1)[0] * 30.0
    np.testing.assert_allclose(found.motion[0], mode(total) + 2e-3 * total, rtol=1e-9, atol=1e-14)
    t = np.arange(512) / 512
    z = np.real(found.motion[0] @ np.exp(2j * np.pi * np.outer(np.arange(8), t)))
    np.testing.assert_allclose(law_force[1], 2 * np.fft.fft(3e5 * z**3)[1] / 512, rtol=1e-8)
    assert found.stable


def test_a_light_duffing_follows_multiple_scales():
    """Equation 5.8 is of first order in epsilon: near resonance both agree within 2.5 percent, in both directions."""
    epsilon = 0.02
    curve = duffing(epsilon).curve(0.97 / TURN, 1.05 / TURN, step=0.05)
    exact, omega = Duffing(epsilon=epsilon), np.linspace(0.975, 1.045, 29)
    for direction in ("forward", "backward"):
        ours = curve.swept(omega / TURN, direction)
        theirs = np.squeeze(exact.amplitude(exact.nominal, (omega - 1.0) / epsilon, direction))
        away = np.abs(np.log(ours / theirs))
        assert np.median(away) < 0.015
        assert np.quantile(away, 0.9) < 0.025


@pytest.mark.parametrize("epsilon", [0.004, 0.0008])
def test_the_upper_branch_of_a_lightly_damped_oscillator_is_stable(epsilon):
    """With a damping ratio of 1e-3 and 2e-4: the sweep upwards stays above until the fold, as equation 5.8 has it."""
    curve = duffing(epsilon).curve((1 - 1.2 * epsilon) / TURN, (1 + 2.7 * epsilon) / TURN, step=0.02)
    exact, sigma = Duffing(epsilon=epsilon), np.linspace(-1.0, 2.5, 61)
    for direction in ("forward", "backward"):
        theirs = np.squeeze(exact.amplitude(exact.nominal, sigma, direction))
        ours = curve.swept((1 + epsilon * sigma) / TURN, direction)
        assert ours == pytest.approx(theirs, rel=1.5 * epsilon + 2e-3)


@pytest.mark.parametrize(
    ("law", "p", "frequency", "high"), [("cubic", (1.0,), 0.22, 0.35), ("clearance", (8.0, 0.4), 0.3, 0.5)]
)
def test_branches_are_where_time_integration_ends_and_the_middle_one_is_left(law, p, frequency, high):
    made = balance(law, p, harmonics=9)
    curve = made.curve(0.1, high)
    assert len(curve.folds) == 2
    between = [i for i in range(len(curve.orbits)) if curve.folds[0] + 1 < i < curve.folds[1] - 1]
    assert not curve.stable[between].any()
    outside = [i for i in range(len(curve.orbits)) if i < curve.folds[0] - 1 or i > curve.folds[1] + 1]
    assert curve.stable[outside].all()
    near = [min(part, key=lambda i: abs(curve.frequency[i] - frequency)) for part in _parts(curve)]
    found = [made.solve(frequency, curve.orbits[i]) for i in near]  # upper, middle, lower
    amplitudes = [abs(o.harmonics[0, 1]) for o in found]
    assert amplitudes[0] > 1.04 * amplitudes[1] > 2 * amplitudes[2]
    assert [o.stable for o in found] == [True, False, True]
    one = np.ones((1, 1))
    truth = Truth(one, 0.05 * one, one, 0.1 * ONE, [(law, ONE, p)], TURN * frequency)
    for o in (found[0], found[2]):  # started beside it, motion a tenth off
        spectrum, _ = truth.steady(130, 1.1 * _state(o))
        assert abs(spectrum[0, 1] - o.harmonics[0, 1]) < 2e-3 * abs(o.harmonics[0, 1])
        assert abs(spectrum[0, 3] - o.harmonics[0, 3]) < 2e-3 * abs(o.harmonics[0, 1])
    spectrum, _ = truth.steady(0, _state(found[1]))  # it holds for a period,
    assert abs(spectrum[0, 1] - found[1].harmonics[0, 1]) < 5e-3 * amplitudes[1]
    spectrum, _ = truth.steady(130, _state(found[1]) * 1.001)  # and not for good
    assert min(abs(spectrum[0, 1] - found[i].harmonics[0, 1]) / amplitudes[i] for i in (0, 2)) < 2e-3
    up, down = (curve.swept([frequency], way)[0] for way in ("forward", "backward"))
    assert (up, down) == (pytest.approx(amplitudes[0], rel=2e-2), pytest.approx(amplitudes[2], rel=2e-2))


def _parts(curve):
    a, b = curve.folds
    return range(a), range(a, b + 1), range(b + 1, len(curve.orbits))


def _state(orbit):
    """Displacement and speed of the first output when the drive is at its peak."""
    x, w = orbit.harmonics[0], TURN * orbit.frequency
    return np.array([x.sum().real, (1j * w * np.arange(x.size) * x).sum().real])


def test_a_softening_spring_folds_to_lower_frequencies():
    curve = balance("cubic", (-0.1,), 0.05, damping=0.04).curve(0.1, 0.2)
    assert len(curve.folds) == 2
    omega = np.linspace(0.11, 0.19, 81)  # with 0.149 Hz between the folds
    up, down = (curve.swept(omega, way) for way in ("forward", "backward"))
    assert down[39] > 2 * up[39]
    np.testing.assert_allclose(up[:30], down[:30], rtol=1e-12)


LAWS = {
    "cubic": (1.0,), "quadratic": (0.2,), "one-sided-gap": (5.0, 0.1), "clearance": (5.0, 0.1), "coulomb": (0.04,),
    "quadratic-damping": (0.4,), "jenkins": (1.0, 0.06), "bouc-wen": (1.0, 8.0, 4.0, 1.5),
}  # fmt: skip


@pytest.mark.parametrize("law", sorted(LAWS))
def test_what_the_drive_puts_in_is_lost(law):
    """In every period: by the dashpot, c pi omega n^2 |X_n|^2, and by the law, which is nothing for springs."""
    found = balance(law, LAWS[law], harmonics=9, damping=0.1).solve(0.15)
    n, x = np.arange(10), found.harmonics[0]
    dashpot = np.pi * 0.1 * TURN * 0.15 * np.sum(n**2 * np.abs(x) ** 2)
    assert found.work == pytest.approx(dashpot + found.lost.sum(), rel=1e-7)
    if law in ("cubic", "quadratic", "one-sided-gap", "clearance"):
        assert abs(found.lost[0]) < 1e-4 * found.work  # as little as the samples of a period let through
    else:
        assert found.lost[0] > 0.02 * found.work


def test_what_a_slider_takes_is_its_loop():
    """A spring k in series with a slider at F loses 4 F (Z - F / k) in a period between the ends +-Z of its motion."""
    found = balance("jenkins", (1.0, 0.06), harmonics=21, damping=0.1).solve(0.15)
    t = np.arange(4096) / 4096
    z = np.real(found.motion[0] @ np.exp(2j * np.pi * np.outer(np.arange(22), t)))
    assert found.lost[0] == pytest.approx(4 * 0.06 * (z.max() - 0.06), rel=1e-3)


def test_quadratic_drag_lowers_a_peak_as_its_describing_function_says():
    free, dragged = (balance("quadratic-damping", (c,), harmonics=3).curve(0.8 / TURN, 1.2 / TURN) for c in (0.0, 0.2))
    # at resonance the force is spent on both dampers: c A + (8 / 3 pi) c2 A^2 = F, describing function
    drag = 8 / (3 * np.pi) * 0.2
    assert free.amplitude().max() == pytest.approx(2.0, rel=1e-2)
    assert dragged.amplitude().max() == pytest.approx(
        (-0.05 + np.sqrt(0.05**2 + 4 * drag * 0.1)) / (2 * drag), rel=2e-2
    )


def test_harmonics_that_are_missed_are_told():
    few, many = (balance("clearance", (8.0, 0.1), harmonics=h).solve(0.12) for h in (3, 15))
    exact = balance("clearance", (8.0, 0.1), harmonics=31).solve(0.12).harmonics[0, 1]
    assert few.missed > 20 * many.missed
    assert abs(few.harmonics[0, 1] - exact) > 20 * abs(many.harmonics[0, 1] - exact)


def test_resonances_that_no_law_feels_are_followed():
    """The law is at a node of nothing: without strength; the curve has each peak of the receptance."""
    structure = chain()
    curve = HarmonicBalance(structure, "2:x", 1.0, harmonics=1).curve(1.0, 9.0)
    output, drive = Channel("u", "displacement", "response", "2", "x"), Channel("f", "force", "reference", "2", "x")
    exact = np.abs(frf(structure, structure.nominal, np.linspace(1, 9, 20001), [output], [drive])[0, 0])
    peaks = exact[1:-1][(exact[1:-1] > exact[:-2]) & (exact[1:-1] > exact[2:])]
    seen = curve.amplitude()
    found = seen[1:-1][(seen[1:-1] > seen[:-2]) & (seen[1:-1] > seen[2:])]
    assert found == pytest.approx(peaks, rel=1e-2)


def test_progress_is_told():
    told = []
    balance("cubic", (0.1,), harmonics=1).curve(0.1, 0.2, progress=lambda done, span: told.append((done, span)))
    assert told[0][0] == 0.0
    assert told[-1][0] == pytest.approx(told[-1][1])


def test_what_cannot_be_is_refused():
    with pytest.raises(ModelError, match="9:x"):
        HarmonicBalance(single(), "9:x", 1.0)
    with pytest.raises(ModelError, match="no moving base"):
        HarmonicBalance(single(), "base", 1.0)
    with pytest.raises(EstimationError, match="amplitude of the drive is -1"):
        HarmonicBalance(single(), "1:x", -1.0)
    with pytest.raises(EstimationError, match="one harmonic or more"):
        HarmonicBalance(single(), "1:x", 1.0, harmonics=0)
    with pytest.raises(EstimationError, match="high end must lie above"):
        balance("cubic", (1.0,)).curve(2.0, 1.0)
    with pytest.raises(EstimationError, match="frequency is 0 Hz"):
        balance("cubic", (1.0,)).solve(0.0)
    with pytest.raises(EstimationError, match="within 10 points"):
        balance("cubic", (1.0,)).curve(0.1, 0.35, most=10)
    with pytest.raises(EstimationError, match="forward or backward"):
        balance("cubic", (0.1,), harmonics=1).curve(0.1, 0.2).swept([0.15], "sideways")
    with pytest.raises(EstimationError, match=r"does not reach 0\.3 Hz"):
        balance("cubic", (0.1,), harmonics=1).curve(0.1, 0.2).swept([0.3], "forward")
    undamped = Chain({"1": 1.0}, (Link("1", "ground", "k"),), (Parameter("k", TURN**2, 1.0, 100.0, "N/m"),))
    with pytest.raises(ModelError, match="undamped mode lies at 1 Hz"):
        HarmonicBalance(undamped, "1:x", 1.0, harmonics=3).solve(0.5)


def test_where_nothing_periodic_is_found_it_says_so():
    """A spring whose own slope is lost beyond z = 2.5: a large force has no motion that it could hold."""
    with pytest.raises(EstimationError, match=r"does not converge at 0\.05 Hz"):
        balance("quadratic", (0.2,), 20.0).solve(0.05)
