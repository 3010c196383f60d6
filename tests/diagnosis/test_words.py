"""What a diagnosis says in words."""

from types import SimpleNamespace

import pytest

from labnnum.diagnosis.words import next_experiment, summarise
from labnnum.mechanisms.base import Place


def _named(misfit, orbits=(None,), shown=0.019):
    """A diagnosis that names dry friction, which leaves this much a value."""
    mechanism = SimpleNamespace(id="coulomb-friction", domain="nonlinear", sense=lambda term, value: None)
    place = Place("ground", "3")
    one = SimpleNamespace(
        term=SimpleNamespace(mechanism=mechanism, parameters=(), place=place), place=place, value=(), std=(),
        confidence=1.0,
    )  # fmt: skip
    laws = (SimpleNamespace(made=SimpleNamespace(orbits=orbits)),)
    errors = {"shown": shown, "noise": 0.001, "extended_error": (0.02, 0.02)}
    law = SimpleNamespace(named=(one,), misfit=misfit, equal=(), laws=laws, **errors)
    return SimpleNamespace(
        verdict="missing-physics", named=(one,), place=place, alternatives=(), base_error=(0.5, 0.5),
        extended_error=(0.02, 0.02), noise_floor=0.001, creep=None, detail={"nonlinear": law},
    )  # fmt: skip


@pytest.mark.parametrize(("misfit", "more"), [(0.8, False), (40.0, True)])
def test_a_law_that_leaves_much_says_so_and_asks_for_more(misfit, more):
    d = _named(misfit)
    assert ("40 times what noise" in summarise(d)) is more
    assert ("Repeat at lower levels" in next_experiment(d, ())) is more


@pytest.mark.parametrize(("tight", "said"), [(None, False), (0.0, False), (0.3, True)])
def test_a_law_that_was_compared_in_step_says_so(tight, said):
    tie = None if tight is None else SimpleNamespace(tight=tight)
    d = _named(0.8, (None, SimpleNamespace(tie=tie)))
    assert ("in step with the motion" in summarise(d)) is said


@pytest.mark.parametrize(("shown", "said"), [(0.002, True), (0.019, False), (float("nan"), False)])
def test_a_simulation_that_ends_in_another_state_is_told(shown, said):
    assert ("another steady state" in summarise(_named(0.8, shown=shown))) is said


@pytest.mark.parametrize(("mechanism", "said"), [("channel-clipping", "wider range"), ("channel-gain", "transducer")])
def test_what_to_do_about_a_channel(mechanism, said):
    d = _named(0.8)
    d.named[0].term.mechanism = SimpleNamespace(id=mechanism, domain="channel")
    assert said in next_experiment(d, ())
