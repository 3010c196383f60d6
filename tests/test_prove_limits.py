"""Detection limits: what is drawn, and the fit of a surface whose answers are known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import expit

from labnnum.errors import ConfigError, EstimationError
from sessions.prove import limits
from sessions.prove.limits import Probe, Seen
from sessions.prove.truth.nonlinear import NONLINEAR

SLOPE, PER_DB = 2.0, 0.1
POWER = {"cubic-stiffness": 2.0, "coulomb-friction": -1.0}
START = {"cubic-stiffness": -6.0, "coulomb-friction": -8.0}


def answered(n, seed=4):
    """Answers of a tool whose limit is known: ln m = start - PER_DB / SLOPE (snr - 60) - power ln level."""
    rng = np.random.default_rng(seed)
    out = []
    for i in range(n):
        law = list(POWER)[i % 2]
        m, level, snr = np.exp(rng.uniform(-11, -1)), rng.uniform(-30, 0), rng.uniform(35, 80)
        at = START[law] - PER_DB / SLOPE * (snr - 60) - POWER[law] * np.log(10) * level / 20
        chance = expit(SLOPE * (np.log(m) - at))
        out.append(Seen(law, float(m), float(level), float(snr), bool(rng.random() < chance)))
    return out


@pytest.mark.parametrize("law", POWER)
def test_a_known_limit_comes_back_within_its_interval(law):
    surface = limits.fit(answered(1200))
    power, off = surface.exponent(law)
    assert off < 0.35
    assert power == pytest.approx(POWER[law], abs=3 * off)
    for level, snr in limits.SHOWN:
        at, std = surface.limit(law, level, snr)
        true = START[law] - PER_DB / SLOPE * (snr - 60) - POWER[law] * np.log(10) * level / 20
        assert std < 0.6
        assert at == pytest.approx(true, abs=3 * std)


def test_intervals_hold_known_limits_as_often_as_they_say():
    held = []
    for seed in range(40):
        surface = limits.fit(answered(240, seed))
        for law in POWER:
            at, std = surface.limit(law, 0.0, 60.0)
            held.append(abs(at - START[law]) <= limits.NINETY * std)
    assert 0.8 <= np.mean(held) <= 0.99


def test_no_answers_give_no_limit():
    with pytest.raises(EstimationError, match="no probe"):
        limits.fit([])


def test_probes_depend_on_the_seed_alone_and_hold_every_law():
    some = limits.draw(16, 1000)
    assert some == limits.draw(16, 1000)
    assert some != limits.draw(16, 1001)
    assert {p.faults[0] for p in some} == set(NONLINEAR)
    with pytest.raises(ConfigError, match="--cases 3"):
        limits.draw(3, 1000)
    with pytest.raises(ConfigError, match="--seed -1"):
        limits.draw(16, -1)


def test_level_and_noise_are_what_was_asked_for():
    probe = next(p for p in limits.draw(32, 7) if p.faults == ("cubic-stiffness",) and p.kind == "chain")
    weak, strong = (replace(probe, level=x).measured() for x in (-20.0, 0.0))
    force = [np.sqrt(np.mean(c.runs[-1].data[0] ** 2)) for c in (weak, strong)]
    assert force[0] / force[1] == pytest.approx(0.1, rel=1e-2)
    faint = replace(probe, severities=(-3.0,), level=0.0)
    quiet, loud = (replace(faint, snr=x).measured() for x in (80.0, 40.0))
    apart = (loud.runs[-1].data - quiet.runs[-1].data)[1:]
    share = np.sqrt(np.mean(apart**2, axis=1) / np.mean(quiet.runs[-1].data[1:] ** 2, axis=1))
    assert -20 * np.log10(share) == pytest.approx(40.0, abs=8.0)  # a channel's floor scatters by 30 %
    assert faint.truth()["snr_db"] == probe.snr


def nothing_wrong(recordings, model, out):
    (out / "diagnosis.json").write_text(json.dumps({"verdict": "consistent", "place": None, "mechanism": None}))
    return {}


def test_a_run_goes_on_where_it_stopped_and_writes_its_table(tmp_path, monkeypatch):
    monkeypatch.setattr(limits, "answer", lambda p, out, keep, tool: stubbed(p, out))
    seen = []
    limits.run(tmp_path, 8, 5, step=lambda done, total: seen.append((done, total)))
    found = limits.run(tmp_path, 8, 5, step=lambda done, total: seen.append((done, total)))
    assert seen == [*((i, 8) for i in range(9)), (8, 8)]
    assert {r["law"] for r in found["laws"]} == set(NONLINEAR)
    assert sum(r["named"] for r in found["laws"]) == 0
    assert (tmp_path / "limits.md").read_text().count("\n| ") == 1 + len(NONLINEAR)
    with pytest.raises(ConfigError, match="another suite"):
        limits.run(tmp_path, 16, 5)


def stubbed(probe: Probe, out):
    folder = out / "answers" / probe.name
    folder.mkdir(parents=True)
    nothing_wrong([], None, folder)
    (folder / "time.json").write_text('{"wall_s": 1, "cpu_s": 1}')
    return probe.name
