"""Places that move alike, runs that do not repeat, cords on which a floating structure hangs, and damping of hits."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.alike import distinct, others_of
from labnnum.diagnosis.nonlinear.bench import Bench
from labnnum.diagnosis.nonlinear.detect import repeating
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.locate import Lead, Spot, spots
from labnnum.diagnosis.nonlinear.problem import SMOOTH_LAST
from labnnum.diagnosis.nonlinear.receptance import CORDS, SUSPENDED, Base, cords
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.words import summarise
from labnnum.mechanisms.base import Place
from labnnum.nonlinear import Element
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, chain, joint_23, runs

BAND = (2 * np.pi * 0.5, 2 * np.pi * 12)


def rod(stiff: float, ground: bool = True) -> Chain:
    """Four masses; the spring between 2 and 3 is `stiff` times the others."""
    links = [Link("1", "ground", 1000.0, 1.0)] if ground else []
    links += [Link(str(i), str(i + 1), 1000.0 * (stiff if i == 2 else 1.0), 1.0) for i in range(1, 4)]
    return Chain({str(i): 1.0 for i in range(1, 5)}, tuple(links), ())


def every_spot(engine: Engine) -> list[Spot]:
    elements = [("1", "2"), ("2", "3"), ("3", "4")]
    return spots(engine, engine.site(["1", "2", "3", "4"], elements, []))


@pytest.mark.parametrize("stiff", [1.0, 1e5])
def test_of_two_nodes_that_move_as_one_one_is_looked_at_and_the_other_told(stiff: float):
    engine = Engine(rod(stiff), OUTPUTS, (FORCE,), BAND)
    every = every_spot(engine)
    kept, equal = distinct(engine, every)
    third = Place("ground", "3")
    assert (third in [s.place for s in kept]) is (stiff == 1.0)
    second = next(s for s in kept if s.place == Place("ground", "2"))
    assert others_of(equal, second) == (() if stiff == 1.0 else (third,))
    assert others_of(equal, replace(second, axis="-x")) == others_of(equal, second)
    assert len(kept) == len(every) - (stiff > 1)


def test_places_that_only_the_first_mode_moves_alike_are_two():
    """On a soft foot it answers ten thousand times as much as the others, which tell them apart all the same."""
    links = [Link("1", "ground", 0.1, 1e-3)]
    links += [Link(str(i), str(i + 1), 1000.0, 1.0) for i in range(1, 4)]
    engine = Engine(Chain({str(i): 1.0 for i in range(1, 5)}, tuple(links), ()), OUTPUTS, (FORCE,), (0.1, BAND[1]))
    every = every_spot(engine)
    state = engine.state(engine.theta0)
    ground = [state.shape.T @ s.column for s in every if s.place.kind == "ground"]
    assert np.ptp([g[0] for g in ground]) < 1e-3 * abs(ground[0][0])
    assert len(distinct(engine, every)[0]) == len(every)


def test_mirror_images_are_two_places():
    """They move as much in every mode, but not in the same sense."""
    masses, links = {str(i): 1.0 for i in range(1, 5)}, [Link("1", "ground", 1000.0, 1.0)]
    links += [Link(str(i), str(i + 1), 1000.0, 1.0) for i in range(1, 4)] + [Link("4", "ground", 1000.0, 1.0)]
    engine = Engine(Chain(masses, tuple(links), ()), OUTPUTS, (FORCE,), BAND)
    every = every_spot(engine)
    assert len(distinct(engine, every)[0]) == len(every)


def test_the_summary_names_the_places_that_move_alike():
    place, others = Place("ground", "5"), (Place("ground", "6"), Place("ground", "17"))
    law = SimpleNamespace(equal=others, laws=(SimpleNamespace(spot=SimpleNamespace(place=place)),))
    said = {"nonlinear": law, "reason": "why"}
    told = SimpleNamespace(verdict="unexplained", named=(), place=place, detail=said, located=())
    assert "ground 6 and ground 17 move as ground 5 does" in summarise(told)  # type: ignore[arg-type]
    elsewhere = SimpleNamespace(**{**vars(told), "place": Place("ground", "4")})
    assert "move as" not in summarise(elsewhere)  # type: ignore[arg-type]


def test_a_run_that_jumps_about_for_ever_is_left_out():
    """Its periods differ by a third of the response, those of the others by a thousandth; where all do, none is."""
    some = runs([], chain(), levels=(1.0, 3.0, 10.0))[:3]

    def with_noise(parts):
        out = []
        for o, p in zip(some, parts, strict=True):
            assert o.run is not None
            noise = np.full(o.run.noise.shape, p**2 * np.mean(np.abs(o.run.y) ** 2))
            out.append(replace(o, run=replace(o.run, noise=noise)))
        return out

    jumps = with_noise((1e-3, 1e-3, 0.5))
    assert repeating(jumps, jumps) == (jumps[:2], jumps[:2])
    noisy = with_noise((0.4, 0.3, 0.5))
    assert repeating(noisy, noisy) == (noisy, noisy)
    two = jumps[1:]
    assert repeating(two, two) == (two, two)  # one level alone would say nothing of a law


def test_cords_and_hysteretic_damping_are_entries_with_exact_slopes():
    floats, stands = Engine(rod(1.0, ground=False), OUTPUTS, (FORCE,), BAND), Engine(chain(), OUTPUTS, (FORCE,), BAND)
    assert cords(stands) == 0
    omega = 2 * np.pi * np.linspace(0.02, 20.0, 60)
    base = Base(floats, floats.start(), np.array([joint_23(), np.eye(4)[1]]).T, omega, decay=0.3)
    x = base.start()
    share, at = (int(i) for i in base.cuts[3:5])
    assert x[share] == 0.0  # the model's damping is viscous
    x[[share, at, at + 1]] = 0.4, -0.3, 0.2
    here = base.at(x)
    assert here.omega[0] == pytest.approx(SUSPENDED * BAND[0] * np.exp(-0.3))
    assert here.zeta[0] == pytest.approx(CORDS * np.exp(0.2))
    sized(base, x, at, True)
    sized(base, x, at + 1, True)
    sized(base, x, share, False)  # what begins at rest has none


def sized(base, x, i, matters):
    """Slopes to one entry are the finite steps', and these are something, or nothing."""
    exact = base.derivatives(x, base.at(x))
    step = 1e-6 * np.eye(x.size)[i]
    here, up, down = base.at(x), base.at(x + step), base.at(x - step)
    for name, slope in zip(("plain", "h", "z", "g"), exact, strict=True):
        finite = (getattr(up, name) - getattr(down, name)) / 2e-6
        assert bool(np.linalg.norm(finite) > 1e-6 * np.linalg.norm(getattr(here, name))) is matters or name == "h"
        assert np.linalg.norm(slope[i] - finite) < 1e-5 * np.linalg.norm(getattr(here, name))


@pytest.mark.parametrize("top", [12.0, 5.0])
def test_hysteretic_damping_of_lasting_motion_has_exact_slopes(top):
    """With modes that are kept, and with some that are flexibility."""
    engine = Engine(rod(1.0, ground=False), OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * top))
    omega = 2 * np.pi * np.linspace(0.02, 20.0, 60)
    base = Base(engine, engine.start(), np.array([joint_23(), np.eye(4)[1]]).T, omega)
    x = base.start()
    share = int(base.cuts[3])
    x[share] = 0.3
    sized(base, x, share, True)
    more = x.copy()
    more[share] = 0.6
    assert np.abs(base.at(more).plain - base.at(x).plain).max() > 0


def test_a_share_of_hysteretic_damping_that_the_quietest_level_got_wrong_is_put_right():
    """Of a viscous structure, at a level at which the law acts already: the share is the fit's, and is not held."""
    made = [o.run for o in runs([Element("clearance", joint_23(), (500.0, 0.004))], chain())]
    engine = Engine(chain(), OUTPUTS, (FORCE,), BAND)
    bench = Bench(engine, replace(engine.start(), law=np.array([0.4])), tuple(made), Scatter(), ()).on(120)
    p = np.zeros(N_P)
    p[:2] = 480.0, 0.0042
    lead = Lead(Spot(Place("joint", "2", "3"), "x", joint_23()), "clearance", p, 0.0)
    joint = bench.joint([lead])
    share = int(next(iter(joint.bases.values())).cuts[3])
    assert joint.start()[share] == 0.4
    found = bench.carry_on(bench.direct([joint.start()[: joint.n_base]], lead, 10), 20)
    assert found.made.x[share] < 0.1
    assert found.made.law(0)[0] == pytest.approx([500.0, 0.004], rel=0.02)
    assert found.made.data_part < found.made.count


def test_nothing_moves_before_a_blow_whatever_damping_a_misled_base_has():
    """Hysteretic damping answers before it is asked: undone from the window of a hit, that grows to the record's end,
    where it had been the largest motion of all, and 2 % of it before the blow.
    """
    floats = Engine(rod(1.0, ground=False), OUTPUTS, (FORCE,), BAND)
    point = replace(floats.start(), law=np.array([1.0, 0.0]))
    n, rate, decay = 4096, 40.0, 0.05
    omega, time = 2 * np.pi * np.arange(n // 2 + 1) * rate / n, np.arange(n) / rate
    blow = np.exp(-(((time - 10.0) / 0.1) ** 2))
    column = np.eye(4)[[1]].T
    base, lasting = Base(floats, point, column, omega, decay), Base(floats, point, column, omega)
    assert base.start()[base.cuts[3]] == 1.0
    response = base.at(base.start()).z[0] * np.fft.rfft(blow * np.exp(-decay * time))
    z = np.abs(np.fft.irfft(response, n) * np.exp(decay * time))
    assert np.max(z[time < 9.0]) < 1e-3 * np.max(z)
    assert np.max(z[time > 95.0]) < 0.1 * np.max(z)
    rigid = lasting.at(lasting.start()).d[: floats.rigid_modes]
    cord = SUSPENDED * BAND[0]
    assert rigid == pytest.approx(np.tile(1 / (cord**2 + 2j * CORDS * cord * omega - omega**2), (1, 1)), rel=1e-9)


@pytest.mark.parametrize(("stiffness", "shorter"), [(500.0, False), (4500.0, True)])
def test_a_last_fit_that_leaves_more_than_noise_for_its_long_steps_takes_shorter_ones(stiffness, shorter):
    """Of a stop that is harder than the structure; and not of a soft one, which leaves no more than noise."""
    law = (stiffness, 0.004)
    made = [o.run for o in runs([Element("clearance", joint_23(), law)], chain())][-2:]
    engine = Engine(chain(), OUTPUTS, (FORCE,), BAND)
    bench = Bench(engine, engine.start(), tuple(made), Scatter(), ()).on(120)
    p = np.zeros(N_P)
    p[:2] = law
    lead = Lead(Spot(Place("joint", "2", "3"), "x", joint_23()), "clearance", p, 0.0)
    one = bench.direct([bench.joint([]).start()], lead, 10)
    coarse, last = (bench.carry_on(one, 20, last=last) for last in (False, True))
    assert coarse.made.data_part > 5 * coarse.made.count
    assert coarse.made.terms[0].steps == 0.0
    assert bool(last.made.terms[0].steps > 2 * SMOOTH_LAST) is shorter
    assert last.made.data_part < last.made.count
    assert last.made.law(0)[0] == pytest.approx(law, rel=0.02)
