"""Where a winning law is tried again: where its own base says that the distortion comes from, or the unbent one does;
which follows are simulated, and how many lines are compared.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis import diagnose
from labnnum.diagnosis.nonlinear import chain, decision, study
from labnnum.diagnosis.nonlinear.bench import Tried
from labnnum.diagnosis.nonlinear.lines import OPEN, PERIODIC, ROUGH, choose_lines
from labnnum.diagnosis.nonlinear.locate import Lead, Spot
from labnnum.diagnosis.verdict import Limits
from labnnum.mechanisms.base import Place
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear import chain as masses
from tests.diagnosis.test_nonlinear import joint_23, runs

SPOTS = [Spot(Place("ground", str(i)), "x", np.eye(5)[i]) for i in range(5)]


def tried(i, cost, x, price=0.0):
    made = SimpleNamespace(data_part=cost, count=100, x=x, prior_part=price, n_base=10, bare=3)
    return SimpleNamespace(spot=SPOTS[i], mechanism="stick-slip", cost=cost, made=made, simulated=True, named=True)


@pytest.mark.parametrize(("rival", "asked"), [(2000.0, [["1"], ["3", "4"]]), (150.0, [["1"]])])
def test_a_law_that_leaves_far_more_than_noise_is_tried_where_its_base_finds_the_force(monkeypatch, rival, asked):
    calls, bases = [], []

    def at_places(found, best, spots, scatter):
        calls.append([s.place.id for s in spots])
        return [tried(1, rival, "rival")] if spots and spots[0] is SPOTS[1] else [tried(3, 90.0, "right")]

    def looked(plain, x, spots):
        bases.append(x)
        return [SimpleNamespace(spot=s, share=0.9) for s in (SPOTS[0], SPOTS[1], SPOTS[3], SPOTS[4])], []

    bench = SimpleNamespace(on=lambda lines: SimpleNamespace(joint=lambda laws: None))
    monkeypatch.setattr(chain, "Bench", lambda *args: bench)
    monkeypatch.setattr(chain, "twins", lambda found, spot, every: [])
    monkeypatch.setattr(chain, "as_well", lambda found, best, every, scatter: [])
    monkeypatch.setattr(chain, "at_places", at_places)
    monkeypatch.setattr(chain, "looked", looked)
    monkeypatch.setattr(chain, "_unbent", lambda found, one, every, scatter: [])
    monkeypatch.setattr(chain, "nearest", lambda found: found)
    best = tried(0, 3000.0, "best")
    recovered = [SimpleNamespace(spot=s, gain=g) for s, g in zip(SPOTS, (10.0, 9.0, 1.0, 1.0, 1.0), strict=True)]
    found = SimpleNamespace(best=best, tried=[best], recovered=recovered, engine=None, point=None, runs=())
    made = chain.rivals(found, SPOTS, None)
    assert calls == asked
    assert bases == (["rival"] if len(asked) > 1 else [])
    assert [t.spot.place.id for t in made] == [a[0] for a in asked]


@pytest.mark.parametrize(("left", "asked"), [(150.0, [["1"], ["2", "3"]]), (250.0, [["1"]])])
def test_a_law_that_does_better_at_another_place_moves_on_from_there(monkeypatch, left, asked):
    """Where its force would do as well is asked of each place that it comes to, and no place twice."""
    costs, calls = {"1": left, "2": 110.0, "3": 120.0}, []
    leads = {"0": (1,), "1": (0, 2, 3), "2": (1, 0, 3)}

    def at_places(found, best, some, scatter):
        calls.append([q.spot.place.id for q in some])
        return [tried(int(i), costs[i], "there") for i in calls[-1]]

    def as_well(found, best, every, scatter):
        return [(1.0, Lead(SPOTS[i], "stick-slip", np.zeros(8), 0.0)) for i in leads[best.spot.place.id]]

    monkeypatch.setattr(chain, "twins", lambda found, spot, every: [])
    monkeypatch.setattr(chain, "as_well", as_well)
    monkeypatch.setattr(chain, "at_places", at_places)
    best = tried(0, 200.0, "best")
    recovered = [SimpleNamespace(spot=s, gain=1.0) for s in SPOTS]
    found = SimpleNamespace(best=best, tried=[best], recovered=recovered, engine=None, point=None, runs=())
    made = chain.rivals(found, SPOTS, None)
    assert calls == asked
    assert [t.spot.place.id for t in made] == [i for some in asked for i in some]


@pytest.mark.parametrize(("price", "asked"), [(5.0, []), (300.0, ["2", "1", "3"])])
def test_a_law_for_which_the_base_bends_far_is_tried_elsewhere_from_the_unbent_base(monkeypatch, price, asked):
    """Its own place is left out, those that had a turn from a bent base are not; the least in cost is at its place."""
    followed = []

    class OnLines:
        def against(self, *tried):
            return self

        def follow(self, x, lead, steps):
            followed.append((x, lead.spot.place.id))
            return lead.spot

        def simulate(self, spot, steps):
            return tried(int(spot.place.id), 40.0 if spot is SPOTS[1] else 900.0, "unbent")

    monkeypatch.setattr(chain, "Bench", lambda *args: SimpleNamespace(on=lambda lines: OnLines()))
    monkeypatch.setattr(chain, "_straightened", lambda found, one, scatter: [])
    monkeypatch.setattr(chain, "in_step", lambda bench, spot, steps: bench.simulate(spot, steps))
    monkeypatch.setattr(chain, "of_fit", lambda one: one.lead)
    monkeypatch.setattr(chain, "twins", lambda found, spot, every: [])
    monkeypatch.setattr(chain, "as_well", lambda found, best, every, scatter: [])
    monkeypatch.setattr(chain, "at_places", lambda found, best, spots, scatter: [])
    best = tried(0, 90.0, "best", price)
    best.lead = Lead(SPOTS[0], "quadratic-damping", np.zeros(10), 1.0)
    recovered = [SimpleNamespace(spot=SPOTS[i], gain=1.0) for i in (0, 2, 1, 3, 4)]
    quiet = SimpleNamespace(x="calm base and motions", data_part=1.0, count=1)
    found = SimpleNamespace(
        best=best, tried=[best], recovered=recovered, engine=None, point=None, runs=(), quiet=quiet
    )  # fmt: skip
    made = chain.rivals(found, SPOTS, None)
    assert followed == [("cal", place) for place in asked]
    assert [t.cost for t in made] == [900.0 if place != "1" else 40.0 for place in asked]


@pytest.mark.parametrize(
    ("left", "price", "asked"),
    [(90.0, 5.0, []), (90.0, 300.0, ["4", "3", "2", "1"]), (900.0, 5.0, ["4", "3", "2", "1"])],
)
def test_a_law_that_leaves_much_or_bends_the_base_is_simulated_where_its_force_would_do_best(
    monkeypatch, left, price, asked
):
    """From the unbent base, with the strength that this takes there; what would do worse than `RIVAL` is left out."""
    simulated = []

    class OnLines:
        def against(self, *tried):
            return self

        def follow(self, x, lead, steps):
            return None

        def direct(self, begins, lead, steps, soften):
            simulated.append((begins, lead.spot.place.id, lead.p[0]))
            return tried(int(lead.spot.place.id), 10.0, "moved") if lead.spot is not SPOTS[2] else None

    def at(i, k):
        return Lead(SPOTS[i], "quadratic-damping", np.full(10, k), 1.0)

    moved = [
        (0.9, at(1, 1.0)),
        (1.4, at(4, 4.0)),
        (1.0, at(2, 2.0)),
        (0.5, at(0, 9.0)),
        (1.1, at(3, 3.0)),
        (0.7, at(1, 7.0)),
    ]
    monkeypatch.setattr(chain, "Bench", lambda *args: SimpleNamespace(on=lambda lines: OnLines()))
    monkeypatch.setattr(chain, "of_fit", lambda one: one.lead)
    monkeypatch.setattr(chain, "twins", lambda found, spot, every: [])
    monkeypatch.setattr(chain, "_straightened", lambda found, one, scatter: [])
    monkeypatch.setattr(chain, "as_well", lambda found, best, every, scatter: moved)
    monkeypatch.setattr(chain, "at_places", lambda found, best, spots, scatter: [])
    best = tried(0, left, "best", price)
    best.lead = at(0, 1.0)
    recovered = [SimpleNamespace(spot=s, gain=1.0) for s in SPOTS]
    quiet = SimpleNamespace(x="calm base and motions", data_part=1.0, count=1)
    found = SimpleNamespace(
        best=best, tried=[best], recovered=recovered, engine=None, point=None, runs=(), quiet=quiet
    )  # fmt: skip
    made = chain.rivals(found, SPOTS, None)
    assert [i for _, i, _ in simulated] == asked
    assert all(begins == ("cal",) and p == float(i) for begins, i, p in simulated)
    assert [t.spot.place.id for t in made] == [i for i in asked if i != "2"]


@pytest.mark.parametrize(("left", "price", "again"), [(80.0, 5.0, True), (80.0, 300.0, True), (120.0, 5.0, False)])
@pytest.mark.parametrize(("left_by_calm", "begins"), [(100.0, "cal"), (900.0, "nominal")])
def test_a_law_that_leaves_little_for_a_bent_base_is_fitted_again_from_the_calm_one(
    monkeypatch, left_by_calm, begins, left, price, again
):
    """From the nominal one where the quietest level is nonlinear itself; and kept if that is better. Elsewhere it is
    tried only if the base is bent still.
    """
    begun = []

    class OnLines:
        def against(self, *tried):
            return self

        def joint(self, terms):
            return None

        def again(self, x, one, lead, steps):
            begun.append((x, lead.spot.place.id))
            return tried(0, left, "calm", price)

    monkeypatch.setattr(chain, "Bench", lambda *args: SimpleNamespace(on=lambda lines: OnLines()))
    monkeypatch.setattr(chain, "engine_start", lambda joint: "nominal")
    monkeypatch.setattr(chain, "of_fit", lambda one: Lead(one.spot, "quadratic-damping", np.zeros(10), 1.0))
    monkeypatch.setattr(chain, "twins", lambda found, spot, every: [])
    monkeypatch.setattr(chain, "as_well", lambda found, best, every, scatter: [])
    monkeypatch.setattr(chain, "at_places", lambda found, best, spots, scatter: [])
    monkeypatch.setattr(chain, "_unbent", lambda found, one, every, scatter: [tried(4, 900.0, one.made.x)])
    strong = []
    monkeypatch.setattr(chain, "_from_nominal", lambda found, one, every, scatter: strong.append(one) or [])
    best = tried(0, 90.0, "best", 300.0)
    quiet = SimpleNamespace(x="calm base and motions", data_part=left_by_calm, count=100)
    recovered = [SimpleNamespace(spot=SPOTS[0], gain=1.0)]
    found = SimpleNamespace(
        best=best, tried=[best], recovered=recovered, engine=None, point=None, runs=(), quiet=quiet
    )  # fmt: skip
    made = chain.rivals(found, SPOTS, None)
    assert begun == [(begins, "0")]
    assert [t.made.x for t in made if t.cost == left] == (["calm"] if again else [])
    bent = [t.made.x for t in made if t.cost == 900.0]
    assert bent == ([] if again and price < 30.0 else ["calm" if again else "best"])
    assert bool(strong) == (bool(bent) and begins == "nominal")


def test_a_strong_law_for_which_the_base_bends_is_begun_elsewhere_from_the_nominal_base(monkeypatch):
    """Where its force does as well there, until one explains the runs with a base that is not bent."""
    begun = []

    def relaxed(bench, x, leads):
        begun.append((x, leads[0].spot.place.id))
        return {"4": None, "3": tried(3, 90.0, "bent", 300.0), "2": tried(2, 1.0, "sound")}[leads[0].spot.place.id]

    leads = [(1.2, SPOTS[4]), (1.1, SPOTS[3]), (1.1, SPOTS[0]), (1.0, SPOTS[2]), (0.9, SPOTS[1]), (0.1, SPOTS[1])]
    bench = SimpleNamespace(joint=lambda terms: None)
    monkeypatch.setattr(chain, "Bench", lambda *args: SimpleNamespace(on=lambda lines: bench))
    monkeypatch.setattr(chain, "engine_start", lambda joint: "nominal")
    monkeypatch.setattr(
        chain, "answered", lambda *args: [(gain, Lead(s, "hysteresis", np.zeros(10), 1.0)) for gain, s in leads]
    )
    monkeypatch.setattr(chain, "relaxed", relaxed)
    found = SimpleNamespace(engine=None, point=None, runs=())
    made = chain._from_nominal(found, tried(0, 90.0, "best", 300.0), SPOTS, None)
    assert begun == [("nominal", "4"), ("nominal", "3"), ("nominal", "2")]
    assert [t.made.x for t in made] == ["bent", "sound"]


def test_a_follow_at_a_second_place_is_simulated_whatever_a_simulation_leaves_at_the_first():
    """At a third only if it leaves as little as a simulation does."""
    follow = SimpleNamespace(spot=SPOTS[1], named=True, simulated=False)
    one, two = tried(0, 10.0, "x"), tried(2, 10.0, "x")
    assert study._elsewhere(follow, [one])
    assert not study._elsewhere(follow, [one, two])
    assert not study._elsewhere(follow, [tried(1, 10.0, "x")])
    assert not study._elsewhere(SimpleNamespace(spot=SPOTS[1], named=False, simulated=False), [one])


def test_runs_with_thousands_of_lines_are_compared_on_more_of_them():
    """But for those whose base is known to miss more than noise."""
    run = runs([], masses(), levels=(1.0,))[0].run
    assert run is not None
    most = 15
    assert choose_lines(run, most).at.size == PERIODIC * most
    assert choose_lines(replace(run, open=True), most).at.size == OPEN * most
    assert choose_lines(replace(run, decay=1.0), most).at.size == most
    assert choose_lines(replace(run, miss=ROUGH), most).at.size == most
    assert choose_lines(run).at.size == np.count_nonzero(run.compared)


def test_a_law_for_which_the_base_bends_beyond_any_sound_structure_is_not_named(monkeypatch):
    """It keeps its place and its reason, and is not called linear: of a base that may not bend at all."""
    monkeypatch.setattr(decision, "WARPED", 0.0)
    found = diagnose(masses(), runs([Element("cubic", joint_23(), (2e4,))], masses()))
    assert found.named == ()
    assert found.verdict == "unexplained"
    assert found.detail["nonlinear"].reason == decision.BOUGHT
    assert str(found.detail["nonlinear"].place) == "joint 2-3"


def yielding(i, cost, mechanism="stick-slip", left=None, count=1000):
    made = SimpleNamespace(count=count, data_part=cost if left is None else left)
    return SimpleNamespace(spot=SPOTS[i], mechanism=mechanism, cost=cost, made=made, simulated=True, more=())


def test_places_are_told_apart_by_what_yields_there_bit_by_bit(monkeypatch):
    """One slider at the wrong place leaves less than one at the right place, where many are."""
    asked = []
    sliders = {"0": 1019.0, "1": 1001.0, "2": 1025.0}

    def all_forms(found, t, scatter):
        asked.append(t.spot.place.id)
        many = yielding(int(t.spot.place.id), sliders[t.spot.place.id], "sliders")
        return [many, t], many.cost / many.made.count

    monkeypatch.setattr(study, "_forms", all_forms)
    others = [yielding(0, 1021.0, "hysteresis"), yielding(1, 1022.0), yielding(2, 1030.0), yielding(3, 1100.0)]
    others += [yielding(4, 1021.0, "clearance")]
    made = study.kindred(None, others, yielding(0, 1020.0), None)
    assert asked == ["0", "1", "2"]
    assert [(t.spot.place.id, t.cost) for t in made[:2]] == [("1", 1001.0), ("1", 1022.0)]
    assert len(made) == 6


@pytest.mark.parametrize(
    ("one", "many", "left", "kept"),
    [
        (1020.0, 1000.0, 1.0, False),  # little, for one more parameter
        (23500.0, 23000.0, 1.0, True),  # five hundred where noise is all that is left
        (46500.0, 46000.0, 2.0, False),  # the same where more is left, which no law may have to do with
        (50000.0, 46000.0, 2.0, True),
    ],
)
def test_one_slider_stands_for_many_unless_they_explain_clearly_more(one, many, left, kept):
    count = round(many / left)
    pair = [yielding(0, many, "sliders", many, count), yielding(0, one, "stick-slip", one, count)]
    assert [t.mechanism for t in study.plainer(pair)] == (["sliders"] if kept else []) + ["stick-slip"]


def test_a_rival_is_told_once_at_a_place_and_with_the_laws_beside_it():
    """Two motions of one joint are one place; a pair is not its first law alone."""
    p = np.zeros(8)
    spots = [Spot(Place("joint", "2", "3"), axis, np.eye(4)[i]) for i, axis in enumerate(("x", "ry"))]
    best = Tried(Lead(SPOTS[4], "stick-slip", p, 0.0), None, 100.0)
    pair = (Lead(SPOTS[1], "sliders", p, 0.0),)
    rivals = [
        Tried(Lead(spots[0], "sliders", p, 0.0), None, 900.0),
        Tried(Lead(spots[1], "stick-slip", p, 0.0), None, 400.0),
        Tried(Lead(spots[1], "stick-slip", p, 0.0), None, 103.0, more=pair),
    ]
    said = decision._alternatives(best, rivals, Limits())
    assert [(a.term.mechanism.id, str(a.term.place)) for a in said] == [("stick-slip", "joint 2-3")] * 2
    assert said[0].why_not.startswith("beside stick-slip at ground 1 it explains as well as stick-slip at ground 4")
    assert said[1].why_not == "leaves 300 more in chi-square than stick-slip at ground 4"


def test_what_pairs_that_explain_as_well_have_in_common_is_certain():
    """And of the others one acts, the best pair's told first."""
    lead = [Lead(s, "hysteresis", np.zeros(10), 1.0) for s in SPOTS]

    def pair(*at):
        return Tried(lead[at[0]], SimpleNamespace(), 1.0, more=tuple(lead[i] for i in at[1:]))

    best, other, alone, apart = pair(3, 4), pair(2, 3), pair(3), pair(1, 2)
    common = decision.shared(best, [other, alone])
    assert common == {("hysteresis", SPOTS[3].place)}
    assert decision.apart(best, [other, alone], common) == tuple(("hysteresis", SPOTS[i].place) for i in (4, 2))
    assert decision.shared(best, [other, apart]) == frozenset()
    assert decision.shared(pair(3), [pair(3, 4)]) == frozenset()  # one law alone is what it is
    assert decision.shared(best, []) == frozenset()
