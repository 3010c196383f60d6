"""What a diagnosis says in words."""

from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear.detect import restless, steadier
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.verdict import Diagnosis
from labnnum.diagnosis.words import next_experiment, summarise
from labnnum.mechanisms.base import Place
from labnnum.recording import Channel


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
    law = SimpleNamespace(named=(one,), misfit=misfit, equal=(), undecided=(), laws=laws, **errors)
    return SimpleNamespace(
        verdict="missing-physics", named=(one,), place=place, alternatives=(), base_error=(0.5, 0.5),
        extended_error=(0.02, 0.02), noise_floor=0.001, creep=None, detail={"nonlinear": law}, held_apart=True,
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


def test_a_further_law_that_may_be_either_of_two_is_told():
    d = _named(0.8)
    assert "which" not in summarise(d)
    d.detail["nonlinear"].undecided = tuple(("quadratic-stiffness", Place("ground", i)) for i in ("4", "3"))
    said = "Beside what is named acts quadratic-stiffness at ground 4 or quadratic-stiffness at ground 3"
    assert said in summarise(d)


@pytest.mark.parametrize(("shown", "said"), [(0.002, True), (0.019, False), (float("nan"), False)])
def test_a_simulation_that_ends_in_another_state_is_told(shown, said):
    assert ("another steady state" in summarise(_named(0.8, shown=shown))) is said


@pytest.mark.parametrize(("mechanism", "said"), [("channel-clipping", "wider range"), ("channel-gain", "transducer")])
def test_what_to_do_about_a_channel(mechanism, said):
    d = _named(0.8)
    d.named[0].term.mechanism = SimpleNamespace(id=mechanism, domain="channel")
    assert said in next_experiment(d, ())


def test_where_nothing_was_held_out_it_is_not_called_so():
    d = _named(0.8)
    assert "The held-out error falls from 50 % to 2 %" in summarise(d)
    d.held_apart = False
    said = summarise(d)
    assert "held-out error" not in said
    assert "all of which were fitted, falls from 50 % to 2 %" in said


@pytest.mark.parametrize(
    ("verdict", "named", "held", "apart"),
    [
        ("missing-physics", (1,), (), False),
        ("missing-physics", (1,), (1,), True),
        ("measurement-fault", (), (), True),  # the errors are the linear search's, which holds some out
        ("measurement-fault", (1,), (), False),
    ],
)
def test_whose_errors_are_told(verdict, named, held, apart):
    of = SimpleNamespace(verdict=verdict, detail={"nonlinear": SimpleNamespace(named=named, held_out=held)})
    assert Diagnosis.held_apart.fget(of) is apart  # type: ignore[attr-defined]
    assert Diagnosis.held_apart.fget(SimpleNamespace(verdict=verdict, detail={})) is True  # type: ignore[attr-defined]


def _unexplained(place, located=(), rivals=(), sensors=("1", "3")):
    laws = [SimpleNamespace(term=SimpleNamespace(mechanism=SimpleNamespace(id=i), place=p)) for i, p in rivals]
    outputs = [Channel(f"a{n}", "acceleration", "response", n, "x") for n in sensors]
    engine = SimpleNamespace(outputs=outputs, structure=SimpleNamespace(supports=("0",)), finer=None)
    return SimpleNamespace(
        verdict="unexplained", place=place, located=located, alternatives=laws, named=(),
        detail={"engine": engine, "reason": "no law fits"},
    )  # fmt: skip


GROUND_2, GROUND_3, JOINT = Place("ground", "2"), Place("ground", "3"), Place("joint", "1", "3")


@pytest.mark.parametrize(
    ("place", "rivals", "said", "unsaid"),
    [
        (GROUND_2, [("a", GROUND_2), ("b", GROUND_2)], "Add a sensor at node 2, and", "tell"),
        (GROUND_2, [("a", GROUND_2), ("b", GROUND_3)], "at node 2 to tell a at ground 2 from b at ground 3", "3 to"),
        (GROUND_3, [("a", GROUND_3), ("b", GROUND_3)], "There are sensors at ground 3 already", "Add"),
        (JOINT, [("a", JOINT), ("b", JOINT)], "There are sensors at joint 1-3 already", "Add"),
        (Place("support", "0"), [], "There are sensors", "Add"),
        (Place("global", "structure"), [], "Nothing tells where it acts", "whole"),
        (Place("channel", "a1"), [], "Exchange the cable", "Add"),
    ],
)
def test_a_sensor_is_asked_for_where_there_is_none(place, rivals, said, unsaid):
    text = next_experiment(_unexplained(place, rivals=rivals), ())
    assert said in text
    assert unsaid not in text


@pytest.mark.parametrize(("share", "many"), [(0.96, True), (0.90, False)])
def test_what_many_places_explain_alike_is_not_put_at_one(share, many):
    others = tuple((Place("ground", str(i)), share) for i in range(3, 9))
    said = summarise(_unexplained(GROUND_2, ((GROUND_2, 0.97), *others)))
    assert said.startswith("Something is missing at ground 2")
    assert ("or spread over all of them" in said) is many


CHANNELS = tuple(Channel(f"a{n}", "acceleration", "response", n, "x") for n in ("1", "3"))
FORCE = Channel("f", "force", "reference", "3", "x")


def _repeated(label, level, scatter, own=1e-3):
    """A run whose periods differ by a part `scatter` of the response, and by the sensors' own noise."""
    y = level * np.ones((2, 50), complex)
    noise = np.full((2, 50), ((scatter * level) ** 2 + own**2) / 5)
    on = np.ones(50, bool)
    run = Run(1.0, 98, y[0], y, noise, on, level, label, CHANNELS, FORCE, 5)
    return SimpleNamespace(run=run, label=label, level=level, kind="periodic", recordings=(), distortion={})


def test_runs_that_do_not_repeat_are_told_and_left_out_where_a_louder_one_repeats():
    quiet, middle, loud = _repeated("quiet", 0.01, 0.0), _repeated("middle", 1.0, 0.2), _repeated("loud", 10.0, 0.0)
    assert quiet.run.unsure[0] > (0.03 * 1.0) ** 2 / 5  # noisy, as quiet runs are: no sign of anything
    assert list(restless([quiet, middle, loud])) == [1]
    assert steadier([quiet, middle, loud]) == [quiet, loud]
    assert steadier([quiet, middle]) == [quiet, middle]  # nothing else shows what it shows
    d = _unexplained(GROUND_2)
    assert "The response of middle (by 20 %) differs from period to period" in summarise(d, [quiet, middle, loud])
    assert "settle for longer before recording middle" in next_experiment(d, [quiet, middle, loud])
    assert "period to period" not in summarise(d, [quiet, loud])


def _seen(kind, level=1.0, length=10.0, distortion=()):
    """One run: hits or a record of some length, and what its detection lines tell."""
    rate = 1000.0
    n = int(length * rate)
    record = SimpleNamespace(rate=rate, spans=lambda: [(0, n)])
    return SimpleNamespace(
        kind=kind, level=level, recordings=(record,) if kind != "frf" else (),
        distortion=dict.fromkeys(distortion, 0.0), frf=SimpleNamespace(settings={"lead": 0.0}), run=None, label=kind,
    )  # fmt: skip


def _linear(verdict="missing-physics", ratio=0.01, hertz=5.0):
    """A diagnosis that names an added mass, of a structure with one mode."""
    d = _unexplained(GROUND_2) if verdict == "unexplained" else _named(0.0)
    d.detail.pop("nonlinear", None)
    if verdict == "missing-physics":
        d.named[0].term.mechanism = SimpleNamespace(id="added-mass", domain="linear", sense=lambda term, value: None)
    engine = SimpleNamespace(
        outputs=(), structure=SimpleNamespace(supports=()), finer=None, band_modes=np.array([0]),
        seen_modes=np.array([0]), state=lambda theta: SimpleNamespace(omega=np.array([2 * np.pi * hertz])),
    )  # fmt: skip
    d.detail["engine"], d.theta, d.damping = engine, np.zeros(0), np.array([ratio])
    return d


LATE = 20 * np.log(20.0) / (2 * np.pi)  # s, until a mode of 5 Hz and 1 % has a twentieth left


@pytest.mark.parametrize("verdict", ["missing-physics", "unexplained"])
@pytest.mark.parametrize(
    ("runs", "blind"),
    [
        ([_seen("hammer")], "All hits are of one level"),
        ([_seen("random"), _seen("random", 1.1)], "One level was recorded, and no line left out of it"),
        ([_seen("frf", np.nan)], "FRFs alone tell no level"),
        ([_seen("hammer"), _seen("hammer", 4.0)], ""),
        ([_seen("periodic", distortion=("odd", "odd_over_noise"))], ""),
        ([_seen("periodic")], "One level was recorded"),
    ],
)
def test_one_level_that_cannot_tell_linear_from_nonlinear_says_so(verdict, runs, blind):
    d = _linear(verdict)
    said, then = summarise(d, runs), next_experiment(d, runs)
    assert ("cannot tell linear from nonlinear" in said) is bool(blind)
    assert ("One level cannot tell linear from nonlinear" in then) is bool(blind)
    assert blind in said
    if blind and verdict == "missing-physics":
        assert "added-mass at ground 3 may stand for a law that changes with level" in said
    if blind:
        assert then.lower().count("repeat at two") == 1


@pytest.mark.parametrize(
    ("kind", "said"), [("hammer", "the window that takes the rest off"), ("random", "leakage of its ends")]
)
@pytest.mark.parametrize(("part", "rings"), [(0.9, True), (1.1, False)])
def test_records_that_end_while_the_response_rings_are_told(kind, said, part, rings):
    d, runs = _linear(), [_seen(kind, length=part * LATE), _seen(kind, 5.0, length=part * LATE)]
    assert (said in summarise(d, runs)) is rings
    assert (f"Record {LATE:.2g} s or more" in next_experiment(d, runs)) is rings
    assert ("6.7 % of its beginning" in summarise(d, runs)) is rings
    periodic = [_seen("periodic", length=1.0, distortion=("odd",)), _seen("periodic", 5.0, length=1.0)]
    assert "beginning" not in summarise(d, periodic)


def test_a_nonlinear_name_is_not_doubted_for_its_one_level():
    d = _named(0.8)
    assert "cannot tell linear" not in summarise(d, [_seen("periodic", distortion=("odd",))])
