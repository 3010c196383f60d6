"""Gates of single hits: pulses of many shapes, ringing, double hits, and real ones."""

import numpy as np
import pytest
from scipy.signal import lfilter

from labnnum.errors import EstimationError
from labnnum.hammer import (
    HitSettings,
    best_hits,
    consistency_verdicts,
    find_pulse,
    force_reach,
    further_pulses,
    hit_transforms,
    hit_verdicts,
    pairwise_coherence,
)

RATE, N = 25600.0, 8192
T = np.arange(N) / RATE


def bump(at: float, length: float, power: float = 1.0) -> np.ndarray:
    u = np.clip((T - at) / length, 0, 1)
    return np.sin(np.pi * u).clip(0) ** power


def response(force: np.ndarray, decay: float = 0.99) -> np.ndarray:
    return lfilter([1.0], [1, -2 * decay * np.cos(0.3), decay**2], force)


def verdicts_of(force, settings=None, noise=1e-3, decay=0.99, seed=0):
    rng = np.random.default_rng(seed)
    x = response(force, decay)
    x = x + noise * np.abs(x).max() * rng.standard_normal(N)
    f = force + noise * np.abs(force).max() * rng.standard_normal(N)
    return {(v.name, v.channel): v for v in hit_verdicts(f, x, RATE, settings)}


@pytest.mark.parametrize("length", [0.2e-3, 0.7e-3, 2e-3, 5e-3])
@pytest.mark.parametrize("power", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("noise", [1e-5, 1e-2])
def test_a_clean_hit_passes_every_gate(length, power, noise):
    found = verdicts_of(100 * bump(0.01, length, power), noise=noise)
    assert all(found.values()), [v.reason for v in found.values() if not v.ok]


@pytest.mark.parametrize("length", [0.2e-3, 1e-3, 5e-3])
@pytest.mark.parametrize("share", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("gap", [1.3, 3.0, 20.0])
def test_a_second_hit_is_found_with_its_size_and_place(length, share, gap):
    force = 100 * (bump(0.01, length, 1.5) + share * bump(0.01 + gap * length, length, 1.5))
    verdict = verdicts_of(force)["double hit", "force"]
    assert not verdict.ok
    assert "double hit" in verdict.reason
    found = further_pulses(force)
    assert len(found) == 1
    at, size = found[0]
    centres = np.array([0.01, 0.01 + gap * length]) + length / 2
    assert np.abs(at / RATE - centres).min() < 0.2 * length + 2 / RATE
    assert size == pytest.approx(share, abs=0.25)


def test_a_small_hit_before_the_main_one_is_found_too():
    assert further_pulses(30 * bump(0.01, 1e-3) + 100 * bump(0.03, 1e-3))


def test_a_second_hit_of_another_contact_time_is_found():
    for length in (0.6e-3, 2e-3):
        assert further_pulses(100 * bump(0.01, 1e-3) + 25 * bump(0.03, length))


def test_ringing_of_the_sensor_is_no_second_hit():
    force = 100 * bump(0.01, 0.5e-3, 1.5)
    for hertz in (3000.0, 6000.0, 9000.0):
        late = np.clip(T - 0.0103, 0, None)
        ringing = 10 * np.exp(-late * 400) * np.sin(2 * np.pi * hertz * late)
        assert further_pulses(force + ringing) == []


def test_clipping_is_found_on_any_channel():
    force = 100 * bump(0.01, 2e-3)
    for known in ({}, {"force": 70.0}):
        assert not verdicts_of(np.minimum(force, 70.0), HitSettings(full_scale=known))["overload", "force"].ok
    x = response(force)
    found = hit_verdicts(force, np.minimum(x, 0.6 * x.max()), RATE, names=("hammer", "acc"))
    assert [(v.name, v.channel) for v in found if not v.ok] == [("overload", "acc")]


def test_level_and_reach_are_held_against_what_was_asked():
    force = 100 * bump(0.01, 1e-3)
    found = verdicts_of(force, HitSettings(force_range=(200.0, 500.0), reach=5000.0))
    assert "hit harder" in found["level", "force"].reason
    assert "harder tip" in found["reach", "force"].reason
    assert "hit softer" in verdicts_of(force, HitSettings(force_range=(1.0, 50.0)))["level", "force"].reason
    assert verdicts_of(force, HitSettings(force_range=(50.0, 500.0), reach=900.0))["reach", "force"].ok


def test_the_reach_of_a_half_sine_is_known():
    # |F(f)|/F(0) = |cos(pi f T)/(1 - (2 f T)^2)|, which falls to a tenth at f T = 1.248
    f = np.linspace(0.6, 1.5, 100001)
    exact = f[np.argmax(np.abs(np.cos(np.pi * f) / (1 - 4 * f**2)) < 0.1)] / 2e-3
    assert force_reach(bump(0.01, 2e-3), RATE, 20.0) == pytest.approx(exact, rel=0.03)


def test_a_response_that_has_not_died_away_names_the_decay_that_would():
    force = 100 * bump(0.01, 0.5e-3)
    found = verdicts_of(force, decay=0.99985)["decay", "response 1"]
    assert not found.ok
    sigma = float(found.reason.split("decay ")[-1].split()[0])
    assert verdicts_of(force, HitSettings(decay=1.01 * sigma), decay=0.99985)["decay", "response 1"].ok


def test_no_pulse_or_a_cut_one_is_said():
    rng = np.random.default_rng(3)
    x = response(bump(0.01, 1e-3))
    quiet = {v.name: v for v in hit_verdicts(rng.standard_normal(N), x, RATE)}
    assert "holds no pulse" in quiet["pulse"].reason
    early = {v.name: v for v in hit_verdicts(bump(-0.5e-3, 1e-3), x, RATE)}
    assert "raise the pre-trigger" in early["pulse"].reason
    late = {v.name: v for v in hit_verdicts(bump(T[-1] - 0.5e-3, 1e-3), x, RATE)}
    assert "lengthen the record" in late["pulse"].reason


def test_dead_channels_end_the_checks():
    force = bump(0.01, 1e-3)
    broken = np.stack([np.full(N, 2.0), np.where(T > 0.1, np.nan, 1.0)])
    found = hit_verdicts(force, broken, RATE)
    assert [v.ok for v in found] == [True, False, False]
    assert "constant" in found[1].reason
    assert "not finite" in found[2].reason


def test_a_negative_hammer_is_a_hammer():
    assert all(verdicts_of(-100 * bump(0.01, 1e-3)).values())
    assert find_pulse(-bump(0.01, 1e-3)).peak == pytest.approx(-1.0, abs=0.01)


def test_hits_that_do_not_fit_are_refused():
    with pytest.raises(EstimationError, match="same samples"):
        hit_verdicts(np.zeros(100), np.zeros((1, 99)), RATE)
    with pytest.raises(EstimationError, match="names"):
        hit_verdicts(bump(0.01, 1e-3), bump(0.02, 1e-3), RATE, names=("a",))
    with pytest.raises(EstimationError, match="second_hit"):
        HitSettings(second_hit=1.5)
    with pytest.raises(EstimationError, match="force_range"):
        HitSettings(force_range=(5.0, 1.0))


def test_the_hit_at_another_point_disagrees_with_the_others():
    rng = np.random.default_rng(4)
    hits = []
    for k in range(5):
        force = rng.uniform(50, 150) * bump(0.01, rng.uniform(0.8e-3, 1.2e-3))
        x = response(force) if k != 3 else lfilter([0.0, 1.0, -0.9], [1, -1.9 * np.cos(0.8), 0.95], force)
        hits.append(np.stack([force, x + 0.01 * x.std() * rng.standard_normal(N)]))
    transforms = hit_transforms(hits, np.fft.rfftfreq(N, 1 / RATE) < 1500)
    pairs = pairwise_coherence(transforms)
    assert pairs.shape == (5, 5, 1)
    np.testing.assert_array_equal(pairs, pairs.transpose(1, 0, 2))
    ok = [v[0].ok for v in consistency_verdicts(transforms, 0.9, ["acc"])]
    assert ok == [True, True, True, False, True]
    assert "hit 4 disagrees" in consistency_verdicts(transforms, 0.9, ["acc"])[3][0].reason
    assert best_hits(transforms, 4) == [0, 1, 2, 4]
    single = consistency_verdicts(transforms[:1], 0.9)
    assert not single[0][0].ok
    assert "at least two" in single[0][0].reason
    with pytest.raises(EstimationError, match="choose"):
        best_hits(transforms, 6)


def test_real_clean_hits_pass_and_agree(recordings):
    hits = []
    for k in range(1, 6):
        _, force, x = np.load(recordings / "hammer_hits" / f"measurements_{k}.npy")
        found = hit_verdicts(force, x, RATE, HitSettings(reach=2000.0), ("hammer", "acc"))
        assert all(found), [v.reason for v in found if not v.ok]
        hits.append(np.stack([force, x]))
        delayed = force + 0.2 * np.roll(force, 300)
        assert not next(v for v in hit_verdicts(delayed, x, RATE) if v.name == "double hit").ok
    mask = (np.fft.rfftfreq(25600, 1 / RATE) > 50) & (np.fft.rfftfreq(25600, 1 / RATE) < 2000)
    assert all(v[0].ok for v in consistency_verdicts(hit_transforms(hits, mask), 0.98))
