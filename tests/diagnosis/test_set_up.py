"""What users bring that is out of the ordinary: monitors, moved sensors, narrow bands, models without parameters."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis import diagnose
from labnnum.diagnosis.diagnose import _seen_by, _split
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import fit
from labnnum.diagnosis.gates import _stiffness_change, drifted, pass_gates
from labnnum.diagnosis.observe import observe, observe_all
from labnnum.diagnosis.places import places_of
from labnnum.diagnosis.pool import pool
from labnnum.diagnosis.prediction import foretold, predicted, relative_error
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.task import Candidate, count, data_of
from labnnum.diagnosis.verdict import Limits
from labnnum.diagnosis.words import next_experiment
from labnnum.diagnosis.worth import _without
from labnnum.errors import ChannelError, EstimationError, ModelError
from labnnum.frf import Frf
from labnnum.mechanisms import AddedMass, OutOfPlaneMode, ShearRotary
from labnnum.recording import Channel
from tests.diagnosis.test_creep import session
from tests.diagnosis.test_engine import FORCE, OUTPUTS, beam, engine
from tests.diagnosis.test_observe import CHAIN, noise, struck_at

PULSES = Channel("tacho", "voltage", "monitor")


def with_pulses(recording):
    """The same beside a tachometer, whose pulses all end at one reading."""
    n = recording.n_samples
    pulses = np.where(np.arange(n) % 40 < 8, 5.0, 0.0) + 1e-3 * np.random.default_rng(5).standard_normal(n)
    return replace(
        recording, channels=(*recording.channels, PULSES), data=np.vstack([recording.data, np.minimum(pulses, 5.0)])
    )


def test_a_monitor_at_its_rail_is_no_fault_of_the_measurement():
    for plain in (noise(40_000), struck_at("1")[0]):
        seen = observe_all([with_pulses(plain)])
        assert "tacho" not in seen[0].clipped
        assert "tacho" not in seen[0].peaks
        assert pass_gates(seen).named == ()


def test_which_of_two_channels_is_named_does_not_depend_on_chance():
    """As many runs of each: the first that is met, and what is left clips in neither."""
    made = observe(noise(40_000))
    names = [c.name for c in (*made.frf.inputs, *made.frf.outputs)]
    clip = SimpleNamespace(score=200.0, share=0.02, level=1.0, times=400)
    runs = [replace(made, clipped={name: clip}, level=5.0) for name in reversed(names)]
    gate = pass_gates([replace(made, level=1.0), *runs])
    assert [n.place.id for n in gate.named] == [names[1]]
    assert [o.clipped for o in gate.usable] == [made.clipped]


def test_hits_of_sensors_that_moved_are_never_averaged():
    first, second = struck_at("1", "1")
    moved = replace(second, channels=(*second.channels[:2], replace(second.channels[2], node="2")), label="second")
    seen = observe_all([first, moved])
    assert [o.frf.n_averages for o in seen] == [3.0, 3.0]
    with pytest.raises(ChannelError, match="second: its channels, or their places, differ"):
        diagnose(CHAIN, seen)


def test_hits_of_all_levels_are_seen_through_one_window():
    soft, hard = struck_at("1", "1")
    longer = replace(hard, data=np.hstack([10 * hard.data, np.zeros((3, 500))]), breaks=(3096, 6192))
    seen = observe_all([soft, longer])
    assert len(seen) == 2
    assert len({o.frf.settings["window_decay"] for o in seen}) == 1
    other = replace(seen[1], frf=replace(seen[1].frf, settings=seen[1].frf.settings | {"window_decay": 0.1}))
    with pytest.raises(ChannelError, match="another exponential window"):
        pool([seen[0], other])


def test_what_is_held_out_lies_in_the_band():
    """One recording far wider than the model's band: a part of what lies inside is held out, of what lies there."""
    made = observe(noise(80_000))
    train, test = _split([made], [], (50.0, 70.0))
    assert test.frequency.size > 10
    assert all(50 <= f <= 70 for frf in (train, test) for f in frf.frequency)
    with pytest.raises(EstimationError, match="are left to compare the model with"):
        _split([made], [], (1000.0, 2000.0))
    below = replace(made, frf=made.frf.lines(10.0, 40.0), label="below")
    with pytest.raises(EstimationError, match="below: held out, and no line between 50 and 70 Hz"):
        _split([made], [below], (50.0, 70.0))


def site_of(made):
    where = places_of(made)
    return made.site(where.nodes, where.elements, where.supports)


def exact(made, outputs):
    """FRFs of a structure at other sensors, without error."""
    other = Engine(made.structure, outputs, made.inputs, made.band)
    frequency = np.linspace(40.0, 2000.0, 300)
    value = other.response(other.start(), (), 2j * np.pi * frequency).value
    return Frf(frequency, value, outputs, made.inputs, None, 1e-6 * np.abs(value) ** 2, 10.0, "H1", {})


def test_held_out_data_of_other_sensors_are_predicted_there():
    made = engine(beam(supports={"1": "clamped"}), inputs=(replace(FORCE[0], node="4"),))
    own = exact(made, OUTPUTS)
    sound = fit(made, data_of(own, Scatter()), (), Scatter(), made.start().vector(), steps=3)
    places = {
        "swapped": OUTPUTS[::-1],
        "moved": tuple(replace(c, node=n) for c, n in zip(OUTPUTS, ("5", "6"), strict=True)),
        "turned": tuple(replace(c, direction="-z") for c in OUTPUTS),
        "speed": tuple(replace(c, quantity="velocity") for c in OUTPUTS),
    }
    for outputs in places.values():
        frf = exact(made, outputs)
        assert relative_error(frf, predicted(made, sound, frf)) < 0.02
        assert np.isnan(foretold(made, sound, frf, Scatter()))
    assert np.isfinite(foretold(made, sound, own, Scatter()))


def test_a_structure_without_parameters_may_be_shaken_at_its_base():
    base = (Channel("table", "acceleration", "base", direction="z"),)
    fixed = beam(supports={"1": "clamped"}, base="z")
    bare = replace(fixed, section=replace(fixed.section, E=7e10), parameters=())
    a, b = (engine(s, inputs=base) for s in (fixed, bare))
    s = 2j * np.pi * np.linspace(40.0, 2000.0, 30)
    np.testing.assert_allclose(b.response(b.start(), (), s).value, a.response(a.start(), (), s).value, rtol=1e-9)


def test_a_response_that_is_no_motion_is_refused_by_name():
    gauge = Channel("gauge", "strain", "response", node="3", direction="z")
    with pytest.raises(ChannelError, match="'gauge' measures strain"):
        Engine(beam(supports={"1": "clamped"}), (*OUTPUTS, gauge), (replace(FORCE[0], node="4"),), (30.0, 2500.0))


def test_shear_is_looked_for_where_nodes_have_coordinates():
    made = engine(beam(supports={"1": "clamped"}), inputs=(replace(FORCE[0], node="4"),))
    site = site_of(made)
    assert len(list(ShearRotary().terms(site))) == 1
    less = replace(site, nodes={n: x for n, x in site.nodes.items() if n != "4"})
    assert len(list(ShearRotary().terms(less))) <= 1


def test_a_mode_that_the_model_lacks_goes_with_its_sensors():
    """Of an extended model: in another order, at fewer places and at new ones."""
    drive = (replace(FORCE[0], node="4"),)
    made = engine(beam(supports={"1": "clamped"}), inputs=drive)
    term = next(iter(OutOfPlaneMode().terms(site_of(made))))
    stored = replace(term, data=term.data | {"dofs": ("3:z", "7:z")})
    values = np.array([120.0, 0.01, 0.3, -0.7])
    for nodes, residues in ((("7", "3"), (-0.7, 0.3)), (("7",), (-0.7,)), (("5", "3"), (0.0, 0.3))):
        outputs = tuple(replace(OUTPUTS[0], name=f"a{n}", node=n) for n in nodes)
        seen, own = _seen_by(stored, values, SimpleNamespace(outputs=outputs))
        np.testing.assert_array_equal(own, [120.0, 0.01, *residues])
        assert [p.name for p in seen.parameters[2:]] == [f"residue_a{n}" for n in nodes]
        other = Engine(made.structure, outputs, drive, made.band)
        s = 2j * np.pi * np.linspace(100.0, 140.0, 5)
        more = other.response(other.start([seen], own), [seen], s).value - other.response(other.start(), (), s).value
        lost = np.array(residues)[:, None] * s**2 / (s**2 + 2 * 0.01 * 240 * np.pi * s + (240 * np.pi) ** 2)
        np.testing.assert_allclose(more[:, 0], lost, rtol=1e-9, atol=1e-12)


def test_a_drift_told_from_one_run_has_the_deviation_that_its_noise_makes():
    sizes = []
    for seed in range(12):
        (one,) = session(0.002, runs=1, periods=4, noise=3e-3, seed=seed)
        size, std = _stiffness_change(one)
        sizes.append((size, std))
    value, std = np.transpose(sizes)
    assert 0.4 < np.std(value, ddof=1) / np.sqrt(np.mean(std**2)) < 2.5
    named, _, _ = drifted(session(0.05, runs=1, periods=4, noise=3e-3))
    if named is not None:
        assert named.std[0] > 1e-5


def test_a_model_with_one_mechanism_less_costs_what_it_leaves(monkeypatch):
    made = engine(beam(supports={"1": "clamped"}), inputs=(replace(FORCE[0], node="4"),))
    data = data_of(exact(made, OUTPUTS), Scatter())
    terms = tuple(t for t in AddedMass().terms(site_of(made)) if t.place.id in "35")[:2]
    x = made.start(terms, np.full(sum(t.n for t in terms), 1e-3)).vector()
    whole = fit(made, data, terms, Scatter(), x, steps=2)
    last = Candidate(terms, whole, whole.objective + 20.0)
    limits = Limits()
    less = _without(made, data, last, 0, Scatter(), [], limits)
    assert less.terms == terms[1:]
    assert less.cost == pytest.approx(less.fit.objective + 20.0 - limits.parameter * count(terms[0]))
    known = Candidate(terms[1:], less.fit, less.fit.objective + 9.0)
    assert _without(made, data, last, 0, Scatter(), [(known,)], limits).cost == pytest.approx(known.cost)

    def nothing(*args, **more):
        raise ModelError("it is no structure")

    monkeypatch.setattr("labnnum.diagnosis.worth.fit", nothing)
    assert _without(made, data, last, 0, Scatter(), [], limits) is None


@pytest.mark.parametrize(
    ("levels", "asked"), [((1.0,), True), ((1.0, 1.00001), True), ((np.nan, np.nan), True), ((1.0, 3.0), False)]
)
def test_another_level_is_asked_for_where_there_is_one(levels, asked):
    runs = [SimpleNamespace(level=level, run=None, label=str(level)) for level in levels]
    said = next_experiment(SimpleNamespace(verdict="consistent"), runs)
    assert ("One level cannot tell" in said) is asked
