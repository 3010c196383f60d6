"""Laws of component tests: exact loops are recognised with their parameters, intervals cover, files are read."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from labnnum.component import EXPLAINED, fit, identify_component, relative_error
from labnnum.component_intervals import beside_viscous, correlation_time, intervals
from labnnum.component_laws import LAWS, ComponentTest, force
from labnnum.component_loops import reversal_travel, work_per_cycle
from labnnum.errors import ChannelError, EstimationError
from sessions.cli import app
from sessions.component import content_of, cycle_of, identify_tests, read_tests

TRUE = {
    "viscous": [120.0],
    "quadratic-damping": [900.0],
    "cubic-stiffness": [4e8],
    "coulomb-friction": [25.0],
    "viscous with spring": [100.0, 6e3],
    "clearance": [3e4, 4e-3],
    "stick-slip": [2e4, 30.0],
    "stick-slip with clearance": [3e4, 40.0, 3e-3],
}
RATE, CYCLES = 256.0, 5


def driven(hertz=1.0, stroke=0.01, cycles=CYCLES, label=""):
    """A sine of the motion, whose force is still nothing."""
    n = round(RATE / hertz)
    w = 2 * np.pi * hertz
    t = np.arange(cycles * n + 1) / RATE
    z, v = stroke * np.sin(w * t), stroke * w * np.cos(w * t)
    return ComponentTest(z, v, np.cos(w * t), n, n, label)


def measured(law, p, test, noise=0.0, seed=0, colour=0.0):
    """The test with a law's force and noise of an autoregression of the first order, relative to the force's RMS."""
    f = force(law, p, test)
    white = np.random.default_rng(seed).normal(size=f.size)
    e = np.empty(f.size)
    e[0] = white[0]
    for i in range(1, f.size):
        e[i] = colour * e[i - 1] + np.sqrt(1 - colour**2) * white[i]
    size = noise * np.sqrt(np.mean(f**2))
    return ComponentTest(test.z, test.v, f + size * e, test.start, test.cycle, test.label)


def seen(law, p, noise=0.0, seed=0):
    """Two tests to fit to, two of other frequencies and strokes that no fit sees."""
    how = [(0.5, 0.010), (1.0, 0.012), (2.0, 0.010), (1.0, 0.020)]
    every = [measured(law, p, driven(*h), noise, seed + i) for i, h in enumerate(how)]
    return every[:2], every[2:]


@pytest.mark.parametrize("law", LAWS)
def test_every_law_is_recognised_in_its_exact_loops_with_its_parameters(law):
    tests, held = seen(law, TRUE[law])
    named = identify_component(tests, held)[0]
    assert named.law == law
    assert named.held_out < 1e-3
    assert_allclose(named.value, TRUE[law], rtol=1e-3)


@pytest.mark.parametrize("law", LAWS)
def test_every_law_is_recognised_in_noise_within_its_intervals(law):
    tests, held = seen(law, TRUE[law], noise=0.05, seed=7)
    named = identify_component(tests, held)[0]
    assert named.law == law
    assert named.held_out == pytest.approx(0.05, rel=0.1)
    assert np.all(np.abs(named.value - TRUE[law]) < 3 * named.half)


def test_friction_with_play_rejects_viscous_damping():
    tests, held = seen("stick-slip with clearance", TRUE["stick-slip with clearance"], noise=0.05)
    found = identify_component(tests, held)
    left = {f.law: f.held_out for f in found}
    assert left["viscous"] > EXPLAINED
    assert left["viscous with spring"] > EXPLAINED
    c, half = beside_viscous(found[0].law, found[0].value, tests)
    assert abs(c) < 2 * half
    assert half * np.abs(tests[0].v).max() < 0.1 * 40.0


def test_a_dashpot_beside_friction_is_found_with_its_coefficient():
    law, p = "coulomb-friction", [25.0]
    tests = [measured(law, p, driven(h), 0.05, i) for i, h in enumerate((0.5, 1.0))]
    both = [ComponentTest(t.z, t.v, t.f + 80.0 * t.v, t.start, t.cycle) for t in tests]
    c, half = beside_viscous(law, fit(law, both), both)
    assert abs(c - 80.0) < 2 * half < 40.0


def test_what_no_law_explains_is_not_named():
    """A force with five times the motion's frequency."""
    t = driven()
    other = np.cos(5 * 2 * np.pi * np.arange(t.z.size) / RATE)
    content = content_of(identify_tests([ComponentTest(t.z, t.v, other, t.start, t.cycle)]))
    assert content["law"] is None
    assert content["laws"][0]["held_out"] > EXPLAINED


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_intervals_of_one_test_cover(colour):
    """Nine in ten, of white noise and of noise that hangs together over nine samples; not idly wide."""
    law, p, n = "coulomb-friction", np.array([25.0]), 200
    inside, widths, values = 0, [], []
    for seed in range(n):
        test = measured(law, p, driven(), 0.3, seed, colour)
        value = fit(law, [test])
        _, half, _ = intervals(law, value, [test], value[None])
        inside += int(abs(value[0] - p[0]) <= half[0])
        widths.append(half[0])
        values.append(value[0])
    assert 0.83 < inside / n < 0.96
    assert np.mean(widths) < 1.35 * 1.645 * np.std(values)


def test_intervals_cover_what_differs_from_test_to_test():
    """The friction force scatters by a tenth between three tests: the interval holds their mean's scatter."""
    law, n, inside = "coulomb-friction", 200, 0
    rng = np.random.default_rng(3)
    for seed in range(n):
        forces = 25.0 * (1 + 0.1 * rng.normal(size=3))
        tests = [measured(law, [f], driven(), 0.01, 10 * seed + i) for i, f in enumerate(forces)]
        value = fit(law, tests)
        _, half, _ = intervals(law, value, tests, np.array([fit(law, [t]) for t in tests]))
        inside += int(abs(value[0] - 25.0) <= half[0])
    assert 0.83 < inside / n < 0.96


def test_intervals_of_friction_with_play_cover():
    law, p, n = "stick-slip with clearance", np.array(TRUE["stick-slip with clearance"]), 30
    inside = np.zeros(3)
    for seed in range(n):
        test = measured(law, p, driven(cycles=3), 0.1, seed)
        value = fit(law, [test], p)
        _, half, _ = intervals(law, value, [test], value[None])
        inside += np.abs(value - p) <= half
    assert np.all(inside / n > 0.7)
    assert np.mean(inside / n) > 0.83


def test_what_comes_again_in_every_cycle_counts_once():
    rng = np.random.default_rng(5)
    white = rng.normal(size=2000)
    assert correlation_time(white) == pytest.approx(1.0, abs=0.3)
    cycle = rng.normal(size=200)
    assert correlation_time(np.tile(cycle, 10), 200) == pytest.approx(10 * correlation_time(cycle), rel=0.3)
    slow = np.convolve(rng.normal(size=20010), np.ones(11), "valid")
    assert correlation_time(slow) == pytest.approx(11.0, rel=0.2)


def test_derived_travel_is_play_and_elastic_stroke():
    tests, held = seen("stick-slip with clearance", TRUE["stick-slip with clearance"], noise=0.02)
    named = identify_component(tests, held)[0]
    k, limit, play = named.value
    found = {name: (value, half) for name, _, value, _, half in named.derived}
    assert found["full travel"][0] == pytest.approx(play + 2 * limit / k)
    for name, truth in (("half travel", 3e-3 + 40 / 3e4), ("full travel", 3e-3 + 80 / 3e4)):
        assert abs(found[name][0] - truth) < 2 * found[name][1] < 0.2 * truth


def test_work_and_travel_of_a_loop_are_exact():
    """A rectangle's work is four times force and stroke; a slider behind play loses 4 F (A - F / k - b / 2)."""
    test = driven(cycles=4)
    assert work_per_cycle(test, 25.0 * np.sign(test.v)) == pytest.approx(4 * 25.0 * 0.01, rel=2e-3)
    k, limit, play = TRUE["stick-slip with clearance"]
    f = force("stick-slip with clearance", [k, limit, play], test)
    late = ComponentTest(test.z[256:], test.v[256:], f[256:], 0, 256)
    assert work_per_cycle(late, f[256:]) == pytest.approx(4 * limit * (0.01 - limit / k - play / 2), rel=5e-3)
    assert reversal_travel(late, f[256:], limit / 2) == pytest.approx(play + limit / k, abs=4e-4)
    viscous = force("viscous", [120.0], test)
    assert work_per_cycle(test, viscous) == pytest.approx(np.pi * 120.0 * 2 * np.pi * 0.01**2, rel=1e-3)


def test_wrong_calls_are_told():
    good = driven()
    with pytest.raises(EstimationError, match="no component test"):
        identify_component([])
    with pytest.raises(EstimationError, match="law 'glue' is not one of viscous"):
        force("glue", [1.0], good)
    with pytest.raises(EstimationError, match="t1: force is constant"):
        ComponentTest(good.z, good.v, np.zeros(good.z.size), 0, 0, "t1")
    with pytest.raises(EstimationError, match="t1: velocity has shape"):
        ComponentTest(good.z, good.v[:-1], good.f, 0, 0, "t1")
    with pytest.raises(EstimationError, match="t1: force is not finite"):
        ComponentTest(good.z, good.v, np.full(good.z.size, np.nan), 0, 0, "t1")


# ------------------------------------------------------------------ files

CHANNELS = """
sample_rate = 256.0
[[channel]]
name = "stroke"
quantity = "displacement"
unit = "mm"
role = "base"
source = "z"
[[channel]]
name = "cell"
quantity = "force"
unit = "N"
role = "response"
source = "f"
"""


@pytest.fixture
def files(tmp_path):
    """Two tests to fit to and one held out, in millimetres, without velocity, the force's sign turned."""
    out = []
    for i, (hertz, stroke) in enumerate(((0.5, 0.010), (1.0, 0.012), (2.0, 0.015))):
        t = measured("stick-slip with clearance", TRUE["stick-slip with clearance"], driven(hertz, stroke), 0.03, i)
        out.append(tmp_path / f"test{i}.npz")
        np.savez(out[-1], z=1e3 * t.z, f=-t.f)
    (tmp_path / "channels.toml").write_text(CHANNELS)
    return out


def test_the_cycle_of_a_motion():
    t = np.arange(2000) / RATE
    ramp = np.minimum(1.0, t / 2)
    assert cycle_of(ramp * np.sin(2 * np.pi * 2.0 * t) + 0.3) == 128
    assert cycle_of(np.linspace(0.0, 1.0, 50)) == 50


def test_tests_are_read_in_si_units_with_their_velocity(files):
    tests = read_tests(files)
    assert [t.cycle for t in tests] == [512, 256, 128]
    assert [t.start for t in tests] == [512, 256, 128]
    for t, hertz, stroke in zip(tests, (0.5, 1.0, 2.0), (0.010, 0.012, 0.015), strict=True):
        true = driven(hertz, stroke).v
        assert_allclose(t.v, true, atol=0.02 * np.abs(true).max())


def test_a_component_is_named_from_files(files, tmp_path):
    told = [*map(str, files[:2]), "--held-out", str(files[2]), "-o", str(tmp_path / "out")]
    done = CliRunner().invoke(app, ["component", *told])
    assert done.exit_code == 0, done.output
    assert done.stdout.splitlines()[0].startswith("law: stick-slip with clearance, leaves 3.")
    assert "the recorded force drives the motion" in done.stderr
    content = json.loads((tmp_path / "out" / "component.json").read_text())
    assert content["law"] == "stick-slip with clearance"
    assert content["force_turned"] is True
    for name, true in zip(("k_t", "F_s", "backlash"), TRUE["stick-slip with clearance"], strict=True):
        p = content["parameters"][name]
        assert abs(p["value"] - true) < 3 * p["half_90"]
        assert p["half_90"] < 0.3 * true
    fast = content["tests"][2]
    assert fast["held_out"] is True
    assert fast["work_law_J"] == pytest.approx(fast["work_J"], rel=0.03)
    assert abs(fast["work_viscous_J"] / fast["work_J"] - 1) > 0.3
    drawing = (tmp_path / "out" / "loops.svg").read_text()
    assert drawing.startswith("<svg")
    assert len(drawing) < 100_000


def test_without_held_out_tests_it_says_so(files, tmp_path):
    done = CliRunner().invoke(app, ["component", str(files[0]), "-o", str(tmp_path / "out"), "--json"])
    assert json.loads(done.stdout)["judged_on"] == "the tests fitted to"
    done = CliRunner().invoke(app, ["component", str(files[0]), "-o", str(tmp_path / "out")])
    assert "no test was held out" in done.stderr
    assert "one test was fitted to" in done.stderr


def test_channels_that_do_not_fit_are_named(files, tmp_path):
    two = tmp_path / "two.toml"
    two.write_text(CHANNELS + CHANNELS.split("[[channel]]")[2].join(["[[channel]]", ""]).replace("cell", "second"))
    with pytest.raises(ChannelError, match="cell, second are each a force; say which by --force"):
        read_tests(files[:1], two)
    assert read_tests(files[:1], two, opposing="second")[0].f.size == 2561
    with pytest.raises(ChannelError, match="channel 'stroke' is a displacement; --force takes a force"):
        read_tests(files[:1], opposing="stroke")
    none = tmp_path / "none.toml"
    none.write_text(CHANNELS.replace('"displacement"', '"acceleration"').replace('"mm"', '"m/s^2"'))
    with pytest.raises(ChannelError, match="no channel is a displacement"):
        read_tests(files[:1], none)


def test_a_motion_of_less_than_two_cycles_is_refused(tmp_path):
    t = driven(cycles=2)
    np.savez(tmp_path / "short.npz", z=1e3 * t.z[:400], f=t.f[:400])
    (tmp_path / "channels.toml").write_text(CHANNELS)
    with pytest.raises(EstimationError, match="fewer than two cycles"):
        read_tests([tmp_path / "short.npz"])


# ------------------------------------------------------------------ the friction damper


def test_the_friction_damper_is_friction_with_play(recordings, request):
    from sessions.prove.real_damper import damper

    found = damper(recordings / "friction_damper", request.config.rootpath / "examples/recordings/friction_damper")
    assert found.named.law == "stick-slip with clearance"
    assert len(found.tests) == 2
    assert len(found.held_out) == 3
    left = {f.law: f.held_out for f in found.fits}
    assert left["viscous"] > 3 * left["stick-slip with clearance"]
    c, half = beside_viscous(found.named.law, found.named.value, found.tests)
    assert abs(c) < half
    full = {name: (value, half) for name, _, value, _, half in found.named.derived}
    assert full["half travel"][0] < 7e-3 < full["full travel"][0]
    for t in [*found.tests, *found.held_out]:
        made = force(found.named.law, found.named.value, t)
        assert work_per_cycle(t, made) == pytest.approx(work_per_cycle(t, t.f), rel=0.15)
    slow, fast = (work_per_cycle(t, t.f) for t in (found.tests[0], found.held_out[2]))
    assert fast < 1.1 * slow  # four times the speed: a dashpot would take four times the work
    assert relative_error(found.named.law, found.named.value, found.held_out[2:]) < EXPLAINED
