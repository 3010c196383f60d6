"""Nonlinear diagnosis: steady states against a time march by other code, exact slopes, and whole answers."""

import numpy as np
import pytest

import labnnum.diagnosis.nonlinear.discrete as marching
from labnnum.diagnosis import diagnose, observe_all
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.bench import Bench, Study
from labnnum.diagnosis.nonlinear.detect import signs
from labnnum.diagnosis.nonlinear.discrete import growth, held
from labnnum.diagnosis.nonlinear.explore import engine_start
from labnnum.diagnosis.nonlinear.fitting import fit
from labnnum.diagnosis.nonlinear.force import CODES, HELD, count_of, odds_of, slips
from labnnum.diagnosis.nonlinear.force import YIELDING as YIELDS
from labnnum.diagnosis.nonlinear.joined import levels, with_friction
from labnnum.diagnosis.nonlinear.locate import Lead, Spot
from labnnum.diagnosis.nonlinear.prescribed import along
from labnnum.diagnosis.nonlinear.receptance import Base
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.steady import Steady
from labnnum.diagnosis.nonlinear.within import solved
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.base import Place
from labnnum.mechanisms.hysteresis import Hysteresis
from labnnum.mechanisms.stick_slip import StickSlip
from labnnum.nonlinear import Element, NonlinearSimulation, part_of_limit
from labnnum.parameters import Parameter
from labnnum.recording import Channel, Recording
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from labnnum.system import system
from sessions.report.nonlinear import levels_section

RATE, PERIOD = 40.0, 512
OUTPUTS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in (1, 2, 4))
FORCE = Channel("f", "force", "reference", "3", "x")


def chain(k1="k1", middle=(1000.0, 4.0)):
    """Four masses; `middle` is the link of the second and the third."""
    links = [Link("1", "ground", k1, 4.0)]
    links += [Link(str(i), str(i + 1), *(middle if i == 2 else (1000.0, 4.0))) for i in range(1, 4)]
    prior = (Parameter("k1", 1000.0, 700.0, 1300.0, "N/m", std=50.0),) if k1 == "k1" else ()
    return Chain({str(i): 1.0 for i in range(1, 5)}, tuple(links), prior)


def joint_23():
    column = np.zeros(4)
    column[1], column[2] = -1.0, 1.0
    return column


def multisine(level, seed):
    """Odd lines up to 12 Hz, one in four left out."""
    lines = np.arange(7, 150, 2)
    rng = np.random.default_rng(seed)
    spectrum = np.zeros(PERIOD // 2 + 1, complex)
    on = lines[np.arange(lines.size) % 4 != 2]
    spectrum[on] = np.exp(2j * np.pi * rng.random(on.size)) * level * np.sqrt(2 / on.size)
    return spectrum


def marched(spectrum, elements, structure, fine=16, periods=9):
    """Responses (n_out, n) to a periodic input by the bench's own march, the last period at `fine` samples each."""
    n = PERIOD * fine
    one = np.fft.irfft(np.pad(spectrum, (0, n // 2 - PERIOD // 2)) * n / 2, n)
    march = NonlinearSimulation(system(structure, structure.nominal, OUTPUTS, [FORCE]), elements, 1 / (RATE * fine))
    y = march.run(np.tile(one, periods)[None])
    return y[:, (periods - 2) * n : (periods - 1) * n]


def lines_of(y):
    return np.fft.rfft(y, axis=1)[:, : PERIOD // 2 + 1] * 2 / y.shape[1]


def seated():
    """The chain with a light mass on a stiff spring at node 3, whose mode is far above the band."""
    links = [Link("1", "ground", "k1", 4.0), Link("3", "5", 30000.0, 0.0)]
    links += [Link(str(i), str(i + 1), 1000.0, 4.0) for i in range(1, 4)]
    prior = (Parameter("k1", 1000.0, 700.0, 1300.0, "N/m", std=50.0),)
    return Chain({**{str(i): 1.0 for i in range(1, 5)}, "5": 0.001}, tuple(links), prior)


SEAT = np.array([0.0, -1.0, 0.0, 0.0, 1.0])
"""From node 2 to the light mass of `seated`."""


def steady(structure, spectrum, law, p, place=None):
    engine = Engine(structure, OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    column = place if place is not None else SEAT if len(structure.dofs) == SEAT.size else joint_23()
    base = Base(engine, engine.start(), column[:, None], 2 * np.pi * np.arange(PERIOD // 2 + 1) * RATE / PERIOD)
    none = np.zeros((3, PERIOD // 2 + 1))
    run = Run(RATE, PERIOD, spectrum, none + 0j, none, spectrum != 0, 1.0, "run", OUTPUTS, FORCE, 1)
    parameters = np.zeros((1, 10))
    parameters[0, : len(p)] = p
    return base, Steady(run, np.array([CODES[law]]), 4), parameters


def answered(structure, spectrum, law, p, held=0.0):
    """Responses (n_out, n_lines) without the law and with it, in the steady state."""
    base, solver, parameters = steady(structure, spectrum, law, p)
    parameters[0, HELD] = held
    r = base.at(base.start())
    orbit = solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 25, 1e-6)
    assert orbit.closing < 1e-4
    linear = r.lift * (r.plain * spectrum)
    return linear, linear + r.lift * (r.h * orbit.force).sum(axis=1)


LAWS = [
    ("cubic", (3e4,), "cubic", (3e4,), 2e-3),
    ("quadratic", (3e3,), "quadratic", (3e3,), 2e-3),
    ("one-sided-gap", (500.0, 0.002), "one-sided-gap", (500.0, 0.002), 5e-3),
    ("clearance", (500.0, 0.002), "clearance", (500.0, 0.002), 5e-3),
    ("coulomb", (1.0,), "coulomb", (1.0,), 3e-2),
    ("quadratic-damping", (2.0,), "quadratic-damping", (2.0,), 2e-3),
    ("stick-slip", (400.0, 6.0), "jenkins", (400.0, 6.0), 5e-3),
    ("hysteresis", (400.0, 0.03, 2.0, 0.5), "bouc-wen", (400.0, 0.5 / 0.03**2, 0.5 / 0.03**2, 2.0), 5e-3),
    ("sliders", (400.0, 6.0, 0.7), "", (), 5e-3),
    ("sliders", (400.0, 6.0, 0.6, 3.0), "", (), 5e-3),
]


def spread_sliders(*p):
    """What `stick-slip` with limits that are spread is to the bench: k_t, F_s, spread and, if not many, how many."""
    return StickSlip().elements(StickSlip().term(Place("joint", "2", "3"), "x", joint_23()), p)


@pytest.mark.parametrize(("law", "p", "other", "q", "close"), LAWS, ids=[f"{row[0]}-{len(row[1])}" for row in LAWS])
def test_a_steady_state_is_where_a_long_march_ends(law, p, other, q, close):
    structure, spectrum = chain(), multisine(25.0, 1)
    linear, made = answered(structure, spectrum, law, p)
    elements = [Element(other, joint_23(), q)] if other else spread_sliders(*p)
    truth = lines_of(marched(spectrum, elements, structure))
    inside = slice(7, 150)
    change = np.linalg.norm((truth - linear)[:, inside])
    assert change > 0.01 * np.linalg.norm(truth[:, inside])  # the law matters
    assert np.linalg.norm((made - truth)[:, inside]) < close * np.linalg.norm(truth[:, inside])


YIELDING = [row for row in LAWS if row[0] in ("stick-slip", "hysteresis", "sliders")]


@pytest.mark.parametrize(
    ("law", "p", "other", "q", "close"), YIELDING, ids=[f"{row[0]}-{len(row[1])}" for row in YIELDING]
)
def test_what_was_identified_while_it_stuck_holds_the_spring(law, p, other, q, close):
    """The law beside a structure that has its spring already, against the law with its spring on the one without."""
    spectrum = multisine(25.0, 1)
    stuck, bare = chain(middle=(1400.0, 5.6)), chain(middle=(1000.0, 5.6))
    linear, made = answered(stuck, spectrum, law, p, held=1.0)
    elements = [Element(other, joint_23(), q)] if other else spread_sliders(*p)
    truth = lines_of(marched(spectrum, elements, bare))
    inside = slice(7, 150)
    assert np.linalg.norm((truth - linear)[:, inside]) > 0.01 * np.linalg.norm(truth[:, inside])
    assert np.linalg.norm((made - truth)[:, inside]) < close * np.linalg.norm(truth[:, inside])
    whole = [*p, *{"stick-slip": (0.0, 8.0), "hysteresis": (), "sliders": (8.0,)[len(p) - 3 :]}[law], 1.0]
    of = Hysteresis() if law == "hysteresis" else StickSlip()
    written = of.elements(of.term(Place("joint", "2", "3"), "x", joint_23()), whole)
    again = lines_of(marched(spectrum, written, stuck))
    assert np.linalg.norm((again - truth)[:, inside]) < 2e-3 * np.linalg.norm(truth[:, inside])


@pytest.mark.parametrize("held", [0.0, 1.0])
@pytest.mark.parametrize(("law", "p"), [row[:2] for row in YIELDING])
def test_the_march_and_a_given_motion_have_one_force(law, p, held):
    """Along a motion that starts from rest, and the same less the spring that the structure holds."""
    t = np.linspace(0, 3, 3001)
    z = 0.05 * np.sin(2 * np.pi * t) * (1 - np.exp(-t))
    whole = np.zeros(10)
    whole[: len(p)] = p
    plain = along(CODES[law], z, np.gradient(z, t), whole, 1)
    whole[HELD] = held
    made = along(CODES[law], z, np.gradient(z, t), whole, 1)
    np.testing.assert_allclose(made, plain - held * p[0] * z, atol=1e-12 * np.abs(plain).max())
    memory = np.zeros(8)
    out = np.empty(z.size)
    for i, at in enumerate(z):
        f = solved(CODES[law], 0, at, 0.0, 0.0, 0.0, False, whole[None], memory[None], 0.0, 0.0, 1.0)
        out[i] = -f
        if law == "stick-slip":
            if abs(p[0] * (at - memory[0])) > p[1]:
                memory[0] = at - np.sign(at - memory[0]) * p[1] / p[0]
        elif law == "hysteresis":
            memory[:2] = at, held * at - f / p[0]
        else:
            for k in range(count_of(whole)):
                if slips(k, at, whole, memory):
                    memory[k] = at - np.sign(at - memory[k]) * p[1] * odds_of(k, whole) / p[0]
    np.testing.assert_allclose(out, made, atol=1e-9 * np.abs(made).max())


SLOPES = [
    ("cubic", (3e4,), chain),
    ("quadratic-damping", (2.0,), chain),
    ("clearance", (500.0, 0.002), chain),
    ("coulomb", (2.0,), chain),
    ("coulomb", (2.0,), seated),
    *((*row[:2], chain) for row in YIELDING),
]


@pytest.mark.parametrize(
    ("law", "p", "of", "held"),
    [*((*row, 0.0) for row in SLOPES), *((*row, 1.0) for row in SLOPES if row[0] in YIELDS)],
)
def test_slopes_are_those_of_finite_steps(law, p, of, held):
    if held and law not in YIELDS:
        pytest.skip("only what yields may be held by the structure")
    base, solver, parameters = steady(of(), multisine(25.0, 2), law, p)
    parameters[0, HELD] = held
    x = base.start()
    r = base.at(x)
    orbit = solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 25, 1e-9)
    _, _, dz, dg = base.derivatives(x, r)
    p = p[:3] if law == "sliders" else p  # how many sliders there are has no slope
    vary = np.zeros((len(p), 1, 10))
    vary[np.arange(len(p)), 0, np.arange(len(p))] = 1.0
    _, slope = solver.slopes(r, parameters, orbit, (dz, dg), vary)
    for j, value in enumerate(p):
        ends = []
        for sign in (1, -1):
            moved = parameters.copy()
            moved[0, j] += sign * 1e-4 * value
            ends.append(solver.settle(r, moved, orbit, 25, 1e-9).force)
        finite = (ends[0] - ends[1]) / (2e-4 * value)
        assert np.linalg.norm(slope.force[x.size + j] - finite) < 0.05 * np.linalg.norm(finite)


@pytest.mark.parametrize("limit", [0.5, 2.0, 5.0])
def test_dry_friction_jumps_where_it_does_and_not_where_a_step_ends(limit):
    """Eight steps to a period of the highest line, against sixty-four times as many: from friction that slips most of
    the time, of which a jump at the end of a step would miss 0.4 to 3.3 %, to friction that holds for a part of it.
    """
    spectrum = multisine(25.0, 1)
    base, coarse, parameters = steady(chain(), spectrum, "coulomb", (limit,))
    r = base.at(base.start())

    def response(fine):
        solver = Steady(coarse.run, coarse.codes, fine)
        orbit = solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 40, 1e-6, warm=4)
        return (r.lift * (r.plain * spectrum + (r.h * orbit.force).sum(axis=1)))[:, 7:150]

    fine, made = response(64), response(2)
    assert np.linalg.norm(made - fine) < {0.5: 2e-3, 2.0: 8e-3, 5.0: 2.5e-2}[limit] * np.linalg.norm(fine)


@pytest.mark.parametrize("limit", [0.5, 2.0, 5.0])
def test_dry_friction_on_a_seat_that_gives_way_converges_with_the_square_of_the_step(limit):
    """The truth is a slider with the seat's stiffness on the structure without the light mass."""
    spectrum = multisine(25.0, 1)
    base, coarse, parameters = steady(seated(), spectrum, "coulomb", (limit,))
    r = base.at(base.start())

    def response(fine):
        solver = Steady(coarse.run, coarse.codes, fine)
        assert solver.prepare(r).seated.all()
        orbit = solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 40, 1e-7, warm=4)
        return (r.lift * (r.plain * spectrum + (r.h * orbit.force).sum(axis=1)))[:, 7:150]

    errors = [np.linalg.norm(response(fine) - response(128)) for fine in (4, 16)]
    assert errors[1] < 2e-3 * np.linalg.norm(response(128))
    assert errors[0] > 4 * errors[1]
    slider = marched(spectrum, [Element("jenkins", joint_23(), (30000.0, limit))], chain(), fine=32)
    assert np.linalg.norm(response(128) - lines_of(slider)[:, 7:150]) < 0.01 * np.linalg.norm(response(128))


@pytest.mark.parametrize(
    ("rest", "factor"), [(0.0, 2 + np.sqrt(3)), (0.25, (3.5 + np.sqrt(6.0)) / 2.5), (0.5, 1.0), (2.0, 1.0)]
)
def test_a_mass_that_is_held_rings_unless_it_gives_way(rest, factor):
    """A free mass m on a seat: with c = h^2 / 6 m the force that holds it goes on by the roots of
    (rest + c) x^2 + (4 c - 2 rest) x + rest + c; `rest` in units of c.
    """
    step = 0.1
    T, W0, W1 = held(np.zeros(1), np.zeros(1), step)
    inner = W1[:1] + rest * step**2 / 6
    assert growth(T, W0, W1, np.ones((1, 1)), inner) == pytest.approx(factor, abs=1e-6)


def test_growth_is_that_of_the_march():
    """Two places of five modes held still, step by step, against the largest factor."""
    rng = np.random.default_rng(3)
    omega, zeta, w, step = np.array([0.0, 20.0, 45.0, 80.0, 135.0]), np.full(5, 0.01), rng.normal(size=(2, 5)), 0.02
    T, W0, W1 = held(omega, zeta, step)
    inner = (w * W1[0]) @ w.T + np.diag([3e-5, 5e-5])
    x, f, sizes = rng.normal(size=(2, 5)), np.zeros(2), []
    for _ in range(60):
        push = w.T @ f
        x = np.array([T[0] * x[0] + T[1] * x[1], T[2] * x[0] + T[3] * x[1]]) + W0 * push
        f = -np.linalg.solve(inner, w @ x[0])
        x = x + W1 * (w.T @ f)
        sizes.append(np.abs(f).max())
    assert growth(T, W0, W1, w, inner) == pytest.approx((sizes[-1] / sizes[-21]) ** (1 / 20), rel=0.02)


def test_a_place_that_would_ring_is_held_by_its_speed(monkeypatch):
    """A light mass whose mode turns by nearly half a circle in a step: held, its place rings from step to step, more
    each time, and tangents with it; its speed does not.
    """
    links = [
        Link("1", "ground", "k1", 4.0),
        Link("3", "5", 0.05 * (2 * np.pi * 30) ** 2, 0.0),
        Link("5", "6", 3000.0, 0.0),
    ]
    links += [Link(str(i), str(i + 1), 1000.0, 4.0) for i in range(1, 4)]
    prior = (Parameter("k1", 1000.0, 700.0, 1300.0, "N/m", std=50.0),)
    monkeypatch.setattr(marching, "SEATED", 0.5)
    light = Chain({**{str(i): 1.0 for i in range(1, 5)}, "5": 0.05, "6": 1e-4}, tuple(links), prior)
    spectrum = multisine(25.0, 1)
    base, coarse, parameters = steady(light, spectrum, "coulomb", (2.0,), np.array([0.0, -1.0, 0.0, 0.0, 0.0, 1.0]))
    x = base.start()
    r = base.at(x)

    def solved(fine, p):
        solver = Steady(coarse.run, coarse.codes, fine)
        return solver, solver.settle(r, p, solver.guess(r, np.zeros((solver.n, 1))), 40, 1e-9, warm=4)

    solver, orbit = solved(2, parameters)
    made = solver.prepare(r)
    assert made.inner[0, 0] > 1.5 * (made.w * made.W1[0]) @ made.w.T
    assert growth(made.T, made.W0, made.W1, made.w, made.inner) > 1.5
    assert not made.seated.any()
    _, _, dz, dg = base.derivatives(x, r)
    vary = np.zeros((1, 1, 10))
    vary[0, 0, 0] = 1.0
    _, slope = solver.slopes(r, parameters, orbit, (dz, dg), vary)
    ends = [solved(2, parameters * part)[1].force for part in (1.0001, 0.9999)]
    finite = (ends[0] - ends[1]) / (2e-4 * parameters[0, 0])
    assert np.linalg.norm(slope.force[x.size] - finite) < 0.05 * np.linalg.norm(finite)
    fine, exact = solved(32, parameters)
    assert fine.prepare(r).seated.all()
    r.marches.clear()
    monkeypatch.setattr(marching, "RINGS", 10.0)
    ringing, rung = solved(2, parameters)
    assert ringing.prepare(r).seated.all()
    far, farther = (np.linalg.norm(o.force - exact.force) for o in (orbit, rung))
    assert far < 0.2 * np.linalg.norm(exact.force)
    assert farther > 1.5 * far


@pytest.mark.parametrize("before", [0.7, -0.7, 1e-12, 0.0])
@pytest.mark.parametrize("free", [-3.0, -0.4, -1e-3, 1e-9, 0.2, 5.0])
def test_the_part_of_dry_friction_solves_its_equation(before, free):
    take = 0.3
    part = part_of_limit(free, take, before)
    assert -1 <= part <= 1
    speed = free - take * part
    if abs(part) < 1 and before:
        assert abs(speed - before) * part == pytest.approx(2 * speed, abs=1e-12)
    elif abs(part) < 1:
        assert speed == pytest.approx(0.0, abs=1e-12)
    else:
        assert 2 * speed * part >= abs(speed - before) - 1e-12
    assert part_of_limit(-free, take, -before) == pytest.approx(-part)


def runs(elements, structure, levels=(1.0, 3.0, 9.0), noise=1e-3, sensors=(0, 1, 2), fine=64):
    """Recordings of four periods at each level, two realisations, with noise relative to the lowest level's.

    Through the filter that keeps what lies above half the rate from folding back, as any digitiser has.
    """
    out = []
    floor = None
    for level in levels:
        for realisation in range(2):
            spectrum = multisine(level, 10 * realisation + int(level))
            y = np.fft.irfft(lines_of(marched(spectrum, elements, structure, fine)) * PERIOD / 2, PERIOD)
            floor = noise * y.std(axis=1, keepdims=True) if floor is None else floor
            rng = np.random.default_rng(int(100 * level) + realisation)
            u = np.fft.irfft(spectrum * PERIOD / 2, PERIOD)
            data = np.tile(np.vstack([u, y]), 4)
            data[1:] += floor * rng.standard_normal((3, data.shape[1]))
            data[0] += 1e-4 * level * rng.standard_normal(data.shape[1])
            label = f"level {level:g} run {realisation}"
            heard, rows = [OUTPUTS[i] for i in sensors], [0, *(1 + i for i in sensors)]
            out.append(Recording((FORCE, *heard), data[rows], RATE, period=PERIOD, label=label))
    return observe_all(out)


def test_a_sound_structure_shows_no_sign():
    found = signs([o.run for o in runs([], chain())])
    assert not found.present


@pytest.mark.parametrize(
    ("law", "p", "name", "value"),
    [("cubic", (2e4,), "cubic-stiffness", 2e4), ("quadratic", (-2e3,), "quadratic-stiffness", -2e3)],
)
def test_a_law_between_two_masses_is_located_named_and_measured(law, p, name, value):
    observations = runs([Element(law, joint_23(), p)], chain())
    assert signs([o.run for o in observations]).present
    found = diagnose(chain(), observations)
    assert found.verdict == "missing-physics", found.summary
    assert (found.place.id, found.place.to) == ("2", "3")
    assert found.named[0].term.mechanism.id == name
    assert found.named[0].value[0] == pytest.approx(value, rel=0.1)
    assert found.extended_error[1] < 0.3 * found.base_error[1]
    assert 0 < found.noise_floor < 3 * found.extended_error[1]  # of the spectra, as the errors are
    assert found.as_dict()["mechanism"]["sense"] == ("hardening" if value > 0 else "softening")
    seen = found.detail["nonlinear"]
    plain, own = levels(seen, linear=True), levels(seen)
    assert len(own) == len(seen.study.runs) + len(seen.held_out)
    assert max(p.run.level for p in own) == pytest.approx(9.0, rel=0.05)
    for before, after in zip(plain, own, strict=True):
        f, measured = after.frf()
        made = after.frf(made=True)[1]
        assert np.linalg.norm(made - measured) < 0.02 * np.linalg.norm(measured)
        assert np.array_equal(f, before.frf()[0])
        if after.run.level > 8:
            assert np.all(after.error < 0.3 * before.error)
    page = str(levels_section(found).body)
    assert page.count("<svg") == len(OUTPUTS)
    assert "held out" in page


def test_two_levels_without_a_repetition_are_both_fitted():
    """The loud one held out, all that is fitted would be linear, and a place was blamed that has nothing."""
    quiet, loud = runs([Element("cubic", joint_23(), (1e4,))], chain(), levels=(0.3, 9.0))[::2]
    found = diagnose(chain(), [quiet, loud])
    assert [(n.term.mechanism.id, str(n.place)) for n in found.named] == [("cubic-stiffness", "joint 2-3")]
    assert found.named[0].value[0] == pytest.approx(1e4, rel=0.03)
    assert not found.held_apart
    assert "since no run was held out" in found.as_dict()["fit"]["metric"]
    assert "None was left to be held out" in found.summary
    assert "none was held out" in str(levels_section(found).body)


@pytest.mark.parametrize("dry", [0.0, 3.0])
def test_dry_friction_beside_a_slider_is_found_where_it_acts_and_only_there(dry):
    structure, column = chain(), joint_23()
    elements = [Element("jenkins", column, (400.0, 6.0)), *([Element("coulomb", column, (dry,))] if dry else [])]
    seen = runs(elements, structure, levels=(9.0,), noise=0.05)
    engine = Engine(structure, OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    run = tuple(o.run for o in seen)
    calm = Bench(engine, engine.start(), run, Scatter(), ()).on(150)
    base = fit(calm.joint([]), engine_start(calm.joint([])), [None] * len(run), steps=2)
    p = np.zeros(10)
    p[:2] = 400.0, 6.0
    lead = Lead(Spot(Place("joint", "2", "3"), "x", column), "stick-slip", p, 0.0)
    one = calm.direct((engine_start(calm.joint([])),), lead, 12, soften=False)
    study = Study(engine, engine.start(), run, base, base, (one,), None, ())
    found = with_friction(study, one, [], Scatter(), lines=150)
    if not dry:
        assert found is None
        return
    assert [t.mechanism for t in found.made.terms] == ["stick-slip", "coulomb-friction"]
    assert found.made.law(0)[0] == pytest.approx([400.0, 6.0], rel=0.15)
    assert found.made.law(1)[0] == pytest.approx([dry], rel=0.1)
    assert found.made.data_part < 0.5 * one.made.data_part
