"""Forward selection where a model cannot be built, and where several names stand for one that nobody has."""

from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis import linear
from labnnum.diagnosis.decide import _any_strength, _verdict
from labnnum.diagnosis.scatter import Data
from labnnum.diagnosis.unnamed import told_all
from labnnum.diagnosis.verdict import Limits
from labnnum.errors import ModelError

DATA = Data(1j * np.arange(1.0, 101.0), np.ones((1, 1, 100), complex), np.ones((1, 1, 100)))
NOISE = 2.0 * DATA.value.size


def candidate(data_part, prior_part, cost=0.0):
    """A candidate with 10 errors and parameters; two terms."""
    point = SimpleNamespace(shift=np.zeros(8), theta=np.zeros(2))
    made = SimpleNamespace(data_part=data_part, prior_part=prior_part, point=point, n_theta=2)
    return SimpleNamespace(fit=made, cost=cost, terms=("first", "second"))


@pytest.mark.parametrize(
    ("law", "name", "told"),
    [
        ((NOISE, 5), (NOISE, 400), True),  # a name that asks much of the base
        ((NOISE, 5), (3 * NOISE, 5), True),  # a name that leaves more than noise
        ((NOISE, 5), (NOISE, 8), False),  # both explain it
        ((3 * NOISE, 5), (4 * NOISE, 400), False),  # neither does
    ],
)
def test_a_law_without_a_name_tells_all_where_it_leaves_noise_and_the_name_does_not(law, name, told):
    base, best = candidate(50 * NOISE, 10), candidate(*name)
    assert told_all(candidate(*law), [base, best], DATA, Limits()) == told
    assert not told_all(candidate(*law), [base, best, best], DATA, Limits())


@pytest.mark.parametrize("limits", [Limits(), Limits(alarm=50.0)])
def test_a_name_gains_twice_what_an_alarm_needs(limits):
    """Scatter gives a sound structure in twenty the gain of an alarm: of that nothing is named."""
    base, best = candidate(NOISE, 5, 1000.0), candidate(NOISE, 5, 1000.0 - 1.9 * limits.alarm)
    selection = SimpleNamespace(chain=[base, best], stages=[[best]], general=None)
    verdict, named, reason = _verdict(None, selection, limits, DATA, True, None)
    assert (verdict, named) == ("unexplained", ())
    assert "one sound structure in twenty" in reason


def test_a_second_mechanism_without_which_there_is_no_structure_takes_no_place(monkeypatch):
    def impossible(task, last, pick):
        raise ModelError("the model is singular")

    task, found, first = SimpleNamespace(limits=Limits()), [candidate(NOISE, 5)] * 2, candidate(NOISE, 5, 100.0)
    monkeypatch.setattr(linear, "with_terms", impossible)
    assert linear._in_its_place(task, found, first) is None
    monkeypatch.setattr(linear, "with_terms", lambda task, last, pick: candidate(NOISE, 5, 10.0))
    assert linear._in_its_place(task, found, first).cost == 10.0


@pytest.mark.parametrize(
    ("value", "std", "place", "behind", "any_strength"),
    [
        ([1.6e4], [0.9e4], "17", 0.0, True),  # dashpot or viscoelastic mount: either holds the node
        ([1.6e4], [0.1e4], "17", 0.0, False),  # its strength is told
        ([1.6e4, 2.0], [0.9e4, 0.1], "17", 0.0, False),  # so is another of its parameters
        ([1.6e4], [0.9e4], "5", 0.0, False),  # the other law is elsewhere
        ([1.6e4], [0.9e4], "17", 50.0, False),  # and explains less
    ],
)
def test_a_law_of_any_strength_that_another_at_its_place_equals_is_not_told(value, std, place, behind, any_strength):
    def law(name, place, cost):
        return SimpleNamespace(last=SimpleNamespace(mechanism=SimpleNamespace(id=name), place=place), cost=cost)

    best = law("local-dashpot", "17", 100.0)
    named = SimpleNamespace(value=np.array(value), std=np.array(std))
    assert _any_strength(named, [best, law("viscoelastic", place, 100.0 + behind)], best, 20.0) is any_strength
