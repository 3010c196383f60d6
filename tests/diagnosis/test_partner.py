"""A slider that sticks at the quietest level and another law: neither is found alone, both from far away together."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear import whole
from labnnum.diagnosis.nonlinear.beside import confirmed, finds_first
from labnnum.diagnosis.nonlinear.decision import _warped
from labnnum.diagnosis.nonlinear.explore import engine_start
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.locate import Lead
from labnnum.diagnosis.nonlinear.mended import Fault
from labnnum.diagnosis.nonlinear.partner import partners
from labnnum.diagnosis.nonlinear.stuck import let_go
from labnnum.diagnosis.nonlinear.tempered import relaxed
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.base import Place, Term
from labnnum.mechanisms.channel_gain import ChannelGain
from labnnum.mechanisms.channel_highpass import ChannelHighpass
from labnnum.nonlinear import Element
from labnnum.parameters import Parameter
from tests.diagnosis.test_nonlinear import chain, joint_23, runs
from tests.diagnosis.test_stuck import bench_of

STIFFNESS, LIMIT, CUBIC = 900.0, 25.0, 6e3


@pytest.fixture(scope="module")
def both():
    """A slider between the second mass and the third, and a cubic spring under the fourth."""
    under = np.array([0.0, 0.0, 0.0, 1.0])
    elements = [Element("jenkins", joint_23(), (STIFFNESS, LIMIT)), Element("cubic", under, (CUBIC,))]
    seen = sorted(runs(elements, chain(), (1.0, 6.0, 36.0)), key=lambda o: o.level)
    return bench_of(seen[::2])


def test_both_are_found_from_the_spring_that_the_quietest_level_shows(both):
    bench, _, every = both
    spot = next(s for s in every if (s.place.id, s.place.to) == ("2", "3"))
    p = np.zeros(N_P)
    p[0] = 1.05 * STIFFNESS
    nominal = engine_start(bench.joint([]))
    forms = partners(bench, nominal, Lead(spot, "stick-slip", p, 0.0), 0.03, every)
    assert 2 <= len(forms) <= 3
    assert [f[0].mechanism for f in forms[:2]] == ["stick-slip", "sliders"]
    made = min((relaxed(bench, nominal, two) for two in forms), key=lambda t: t.cost)
    assert made.all_of_it == {("stick-slip", spot.place), ("cubic-stiffness", Place("ground", "4"))}
    assert made.made.law(0)[0][:2] == pytest.approx([STIFFNESS, LIMIT], rel=0.3)  # where the last fits begin
    assert made.made.law(1)[0] == pytest.approx([CUBIC], rel=0.3)


def test_nothing_is_sought_where_the_slider_alone_explains_it():
    slider = Element("jenkins", joint_23(), (STIFFNESS, LIMIT))
    bench, _, every = bench_of(sorted(runs([slider], chain(), (1.0, 6.0, 36.0)), key=lambda o: o.level)[::2])
    spot = next(s for s in every if (s.place.id, s.place.to) == ("2", "3"))
    p = np.zeros(N_P)
    p[0] = STIFFNESS
    assert partners(bench, engine_start(bench.joint([])), Lead(spot, "stick-slip", p, 0.0), 0.03, every) == ()


def test_a_spring_may_be_one_slider_or_many(both):
    spot = both[2][0]
    p = np.zeros(N_P)
    p[0] = 500.0
    forms = [form[0] for form in let_go([(Lead(spot, "stick-slip", p, 0.0), 0.02)])]
    assert {f.mechanism for f in forms} == {"stick-slip", "sliders"}
    for f in forms:
        assert f.p[0] == 500.0
        assert 0.0 < f.p[1] <= 500.0 * 0.02
        assert (f.p[2] > 0) == (f.mechanism == "sliders")


def test_a_spring_that_hardly_slips_is_many_sliders_of_which_the_weakest_do(both):
    p = np.zeros(N_P)
    p[0] = 500.0
    ((form,),) = let_go([(Lead(both[2][0], "stick-slip", p, 0.0), 0.02)], hardly=True)
    assert form.mechanism == "sliders"
    weakest, mean = form.p[1] * (1 - form.p[2]), form.p[1]
    assert weakest < 2 * 500.0 * 0.02 < mean


def answer_of(law, total, place=("2", "3"), named=True):
    made = SimpleNamespace(objective=total, count=1)
    one = SimpleNamespace(mechanism=law, spot=SimpleNamespace(place=Place("joint", *place)), made=made)
    return SimpleNamespace(named=named, laws=(one,))


@pytest.mark.parametrize(
    ("law", "at", "costs", "named", "taken"),
    [
        ("stick-slip", ("1", "2"), 0.9, True, True),
        ("coulomb-friction", ("1", "2"), 0.9, True, True),
        ("cubic-stiffness", ("1", "2"), 0.9, True, False),  # a spring beside it slips nowhere
        ("stick-slip", ("2", "3"), 0.9, True, False),  # that is the law itself
        ("stick-slip", ("1", "2"), 1.1, True, False),
        ("stick-slip", ("1", "2"), 0.9, False, False),
    ],
)
def test_one_slider_stands_for_a_law_and_a_spring_beside_it(monkeypatch, law, at, costs, named, taken):
    slider = Lead(SimpleNamespace(place=Place("joint", *at)), "stick-slip", np.ones(N_P), 0.0)
    monkeypatch.setattr(whole, "sticking", lambda *a: [(slider, 0.02)])
    monkeypatch.setattr(whole, "held_of", lambda engine: [])
    alone = answer_of("sliders", costs, at, named)
    search = SimpleNamespace(
        nearly=0.0, engine=None, progress=lambda text: None, _spots=list, _with=lambda *a, given: alone,
        _held=lambda under: SimpleNamespace(bench=SimpleNamespace(engine=None), x=None, base=None, values=None),
    )  # fmt: skip
    found = answer_of(law, 1.0)
    assert whole.Whole._one_for_two(search, found, SimpleNamespace(faults=[])) is (alone if taken else None)


@pytest.mark.parametrize(("price", "warped"), [(90.0, False), (110.0, True)])
def test_a_base_that_pays_a_hundred_an_entry_is_another_structure(price, warped):
    assert _warped(SimpleNamespace(made=SimpleNamespace(prior_part=14 * price, n_base=14))) is warped


def found_first(mechanism, channel, cost):
    """A linear search that leaves 100 and finds a channel's fault first."""
    term = Term(mechanism, Place("channel", channel), (), np.zeros((0, 1)))
    chain_ = [SimpleNamespace(cost=100.0, terms=()), SimpleNamespace(cost=cost, terms=(term,), last=term)]
    return SimpleNamespace(detail={"selection": SimpleNamespace(chain=chain_)})


def test_a_channel_is_believed_where_the_search_beside_the_law_finds_the_same_first():
    fault = Fault(Term(ChannelHighpass(), Place("channel", "a5"), (), np.zeros((0, 1))), np.array([5.5]))
    assert finds_first(found_first(ChannelHighpass(), "a5", 25.0), [fault])
    assert not finds_first(found_first(ChannelHighpass(), "a5", 80.0), [fault])
    assert not finds_first(found_first(ChannelHighpass(), "a4", 25.0), [fault])
    assert not finds_first(found_first(ChannelGain(), "a5", 25.0), [fault])
    assert not finds_first(found_first(ChannelGain(), "a5", 25.0), [])
    alone = found_first(ChannelHighpass(), "a5", 25.0)
    alone.detail["selection"].chain.pop()
    assert not finds_first(alone, [replace(fault)])


def search(mechanism, channel, value, std):
    """A linear search whose first find is a channel's fault of a size."""
    size = Parameter("gain_error", 0.0, -1.0, 1.0, "1")
    term = Term(mechanism, Place("channel", channel), (size,), np.zeros((1, 1)), data={"channel": 0})
    point = SimpleNamespace(terms=np.array([value]), vector=lambda: np.array([value]))
    made = SimpleNamespace(point=point, terms=(term,), n_theta=0, covariance=np.array([[std**2]]))
    chain_ = [SimpleNamespace(cost=100.0, terms=()), SimpleNamespace(cost=95.0, terms=(term,), last=term, fit=made)]
    return SimpleNamespace(detail={"selection": SimpleNamespace(chain=chain_, scatter=Scatter())})


def test_a_fault_that_two_searches_find_as_large_is_believed():
    beside = search(ChannelGain(), "base", 0.185, 0.015)
    (named,) = confirmed(beside, search(ChannelGain(), "base", 0.19, 0.01))
    assert (named.place, named.term.mechanism.id) == (Place("channel", "base"), "channel-gain")
    assert named.value == pytest.approx([0.185])
    assert confirmed(beside, search(ChannelGain(), "base", 0.30, 0.02)) == ()  # not as large
    assert confirmed(beside, search(ChannelGain(), "a1", 0.185, 0.015)) == ()
    assert confirmed(beside, search(ChannelHighpass(), "base", 0.185, 0.015)) == ()
    nothing = search(ChannelGain(), "base", 0.185, 0.015)
    nothing.detail["selection"].chain.pop()
    assert confirmed(beside, nothing) == ()
    assert confirmed(nothing, beside) == ()
