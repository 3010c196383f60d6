"""Cases: what a user's folder holds, and that faults show where they should."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from labnnum.errors import ConfigError
from sessions.prove.cases import (
    KINDS,
    LAWS,
    MAKERS,
    conceal,
    fits,
    make_case,
    matrices,
    measure,
    sound_twin,
    write_case,
)
from sessions.prove.referee import misfit, nominal
from sessions.prove.truth.bench import first_modes
from sessions.prove.truth.outside import OUTSIDE
from sessions.prove.truth.respond import transfer
from sessions.prove.truth.state import plant
from sessions.prove.words import axis_name

ALLOWED = [(k, f) for k in KINDS for f in MAKERS if f not in LAWS and fits(f, k, "multisine")]


def peaks(case):
    return plant(case.state).frequency[: case.state.bench.n_modes]


@pytest.mark.parametrize(("kind", "fault"), ALLOWED)
def test_every_fault_changes_the_response_and_is_named_in_the_truth(kind, fault):
    sound, faulty = conceal(21, kind), conceal(21, kind, fault, 0.9)
    assert [f["mechanism"] for f in faulty.truth["faults"]] == [fault]
    assert json.loads(json.dumps(faulty.truth))["faults"][0]["severity"] == 0.9
    assert sound.truth["faults"] == []
    if fault.startswith("channel") or fault in ("crosstalk", "sensor-resonance"):
        assert faulty.state.channels
    elif fault == "drift":
        assert faulty.state.drift != 0
    elif fault != "shear-rotary":  # there the whole bench is another
        s = 2j * np.pi * np.geomspace(*sound.state.bench.band, 60)
        assert np.max(np.abs(transfer(plant(sound.state), s) / transfer(plant(faulty.state), s) - 1)) > 0.05


def test_faulty_twins_share_structure_damping_and_sensors():
    sound, faulty = conceal(4, "frame"), conceal(4, "frame", "added-mass", 0.9)
    assert sound.state.bench.theta == faulty.state.bench.theta
    assert sound.state.bench.sensors == faulty.state.bench.sensors
    assert np.array_equal(sound.state.ratios, faulty.state.ratios)


def test_a_fault_sits_at_the_same_place_beside_another():
    one = conceal(9, "chain", "local-dashpot", 0.8).state.faults[0]
    two = conceal(9, "chain", ("added-mass", "local-dashpot"), (0.5, 0.8)).state.faults[1]
    assert one == two


def test_mass_lowers_stiffness_raises_compliance_lowers():
    base = peaks(conceal(2, "base-beam"))
    assert np.all(peaks(conceal(2, "base-beam", "support-compliance", 0.9)) < base)
    loss = conceal(3, "chain", "joint-stiffness", 0.9)
    lower = loss.state.faults[0].sense == "loss"
    assert np.all((peaks(loss) <= peaks(conceal(3, "chain")) + 1e-9) == lower)


def test_shear_and_rotary_inertia_lower_high_modes_most():
    thick = conceal(5, "free-beam", "shear-rotary", 1.0)
    without = replace(
        thick.state,
        mesh=replace(thick.state.mesh, bars=tuple(replace(b, shear=np.inf, rotary=0.0) for b in thick.state.mesh.bars)),
    )
    fall = plant(thick.state).frequency[2:6] / plant(without).frequency[2:6]
    assert np.all(np.diff(fall) < 0)
    assert fall[0] < 1


def test_severity_runs_from_invisible_to_gross():
    null = np.median([misfit(conceal(s, "base-beam")) for s in range(5)])
    seen = [misfit(conceal(3, "base-beam", "added-mass", x)) / null for x in (0.0, 1.0)]
    assert seen[0] < 5
    assert seen[1] > 30


def test_the_nominal_model_is_near_the_truth_but_coarser_and_off():
    for kind in KINDS:
        case = conceal(1, kind)
        assert nominal(case).M.shape[0] < plant(case.state).square.size
        assert 0 < misfit(case) < 60


@pytest.mark.parametrize("kind", KINDS)
def test_a_folder_holds_what_a_user_has_and_nothing_of_the_truth(tmp_path, kind):
    case = replace(make_case(7, kind, "added-mass", 0.8), native=False)
    paths = write_case(case, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        ["channels.toml", "model.toml", "structure.npz", *(p.name for p in paths)]
    )
    channels = tomllib.loads((tmp_path / "channels.toml").read_text())
    model = tomllib.loads((tmp_path / "model.toml").read_text())
    run = np.load(paths[0])
    assert [c["name"] for c in channels["channel"]] == run.files
    n = case.plan.samples * (case.plan.drop + case.plan.keep)
    assert {run[name].shape for name in run.files} == {(n,)}
    arrays = np.load(tmp_path / "structure.npz")
    names = [p["name"] for p in model["parameter"]]
    assert arrays["K0"] == pytest.approx(sum(arrays[f"dK_{name}"] for name in names))
    text = "".join(p.read_text() for p in tmp_path.glob("*.toml"))
    assert "added" not in text
    assert {c["node"] for c in channels["channel"]} <= set(model["places"]["nodes"]) | set(model["places"]["supports"])


@pytest.mark.parametrize("kind", ["base-beam", "free-beam"])
def test_a_beam_in_its_own_words_is_the_beam_of_the_matrices(tmp_path, kind):
    case = next(c for s in range(30) if (c := conceal(s, kind)).native)
    write_case(measure(case), tmp_path)
    assert not (tmp_path / "structure.npz").exists()
    model = tomllib.loads((tmp_path / "model.toml").read_text())
    beam, (modulus,) = model["structure"], model["parameter"]
    assert beam["E"] == modulus["name"]
    bar = case.state.bench.coarse.bars[0]
    assert modulus["nominal"] * beam["I"] == pytest.approx(bar.bending)
    assert beam["rho"] * beam["A"] == pytest.approx(bar.mass)
    assert sum(x["mass"] for x in beam["lump"]) == pytest.approx(sum(m for _, m in case.state.bench.coarse.lumps))


@pytest.mark.parametrize("kind", ["base-beam", "free-beam", "frame"])
def test_a_model_in_its_own_words_has_the_modes_of_the_nominal_mesh(tmp_path, kind):
    from labnnum.response import modes
    from sessions.model import read_model

    cases = [conceal(s, kind) for s in range(40)]
    for swing in "yz":
        case = next(c for c in cases if c.native and c.state.bench.swing == swing)
        write_case(measure(case), tmp_path / swing)
        structure = read_model(tmp_path / swing / "model.toml").structure
        exact = first_modes(case.state.bench.coarse, 8)
        found = modes(structure, structure.nominal, 8).frequency
        assert found == pytest.approx(exact, rel=1e-6, abs=1e-3 * exact[-1])
        bench = case.state.bench
        assert {f"{s.node}:{axis_name(bench, s.axis)}" for s in bench.sensors} <= set(structure.dofs)


def test_units_and_signs_of_a_channel_give_back_si(tmp_path):
    for seed in range(40):
        case = conceal(seed, "free-beam")
        if any(s.sign < 0 for s in case.state.bench.sensors) and any(u[0] == "g" for u in case.units):
            break
    case = measure(case)
    paths = write_case(case, tmp_path)
    channels = tomllib.loads((tmp_path / "channels.toml").read_text())["channel"]
    si = {"g": 9.80665, "m/s^2": 1.0, "N": 1.0, "mm/s": 1e-3}
    run = np.load(paths[0])
    for row, entry in zip(case.runs[0].data, channels, strict=True):
        assert run[entry["name"]] * si[entry["unit"]] == pytest.approx(row, rel=1e-6)
    signs = [s.sign for s in case.state.bench.sensors]
    assert [-1 if c["direction"].startswith("-") else 1 for c in channels[1:]] == signs


def test_matrices_of_a_beam_in_the_other_plane_turn_the_sense_of_rotation():
    bench = conceal(1, "base-beam").state.bench
    y, z = (matrices(replace(bench, swing=swing)) for swing in "yz")
    assert set(d.split(":")[1] for d in z["dofs"]) == {"z", "ry"}
    turn = np.array([-1.0 if d.endswith("ry") else 1.0 for d in z["dofs"]])
    assert z["K0"] == pytest.approx(y["K0"] * np.outer(turn, turn))


@pytest.mark.parametrize("excitation", ["multisine", "random", "hammer"])
def test_a_session_repeats_for_its_seed(excitation):
    runs = [make_case(12, "chain", "channel-delay", 0.5, excitation).runs for _ in range(2)]
    assert all(np.array_equal(a.data, b.data) for a, b in zip(*runs, strict=True))


def test_kept_periods_have_settled():
    case = make_case(6, "chain")
    n, data = case.plan.samples, case.runs[-1].data
    last = data[:, -n:]
    first = data[:, case.plan.drop * n : (case.plan.drop + 1) * n]
    assert np.std(last - first) < 0.02 * np.std(last)


def test_a_drifting_session_moves_from_run_to_run():
    case = make_case(6, "chain", "drift", 0.9)
    n = case.plan.samples
    first, last = (case.runs[i].data[1:, -n:] / case.runs[i].level for i in (0, 4))
    still = make_case(6, "chain")
    same = [still.runs[i].data[1:, -n:] / still.runs[i].level for i in (0, 4)]
    assert np.std(first - last) > 5 * np.std(same[0] - same[1])


def test_an_analyser_hands_out_the_true_frf(tmp_path):
    case = make_case(6, "chain", excitation="frf")
    (path,) = write_case(case, tmp_path)
    file = np.load(path)
    units = np.array([size for _, size in case.units])
    exact = transfer(plant(case.state), 2j * np.pi * file["f"])
    found = file["H"][:, 0] * (units[1:] / units[0])[:, None]
    assert np.max(np.abs(found - exact)) < 0.05 * np.max(np.abs(exact))
    assert file["variance"].shape == file["H"].shape
    channels = tomllib.loads((tmp_path / "channels.toml").read_text())
    assert channels["frf"] == {"frequency": "f", "value": "H", "variance": "variance"}


def test_hits_start_before_the_blow_and_die_out():
    case = make_case(8, "frame", excitation="hammer")
    for run in case.runs:
        peak = np.argmax(run.data[0])
        assert 0 < peak < 0.1 * run.data.shape[1]
        assert np.std(run.data[1, -200:]) < 0.1 * np.max(np.abs(run.data[1]))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("plate",), "not one of chain"),
        (("chain", "gremlin"), "gremlin"),
        (("chain", "support-compliance"), "makes no sense"),
        (("base-beam", None, 0.5, "hammer"), "shaken"),
        (("chain", None, 0.5, "wobble"), "wobble"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments, words):
    with pytest.raises(ConfigError, match=words):
        conceal(1, *arguments)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sound_twin_is_another_structure_behind_the_same_model(kind):
    case = conceal(14, kind, "channel-gain", 0.9)
    twin = sound_twin(case, 0)
    ours, theirs = matrices(case.state.bench), matrices(twin.state.bench)
    assert all(np.array_equal(ours[key], theirs[key]) for key in ours)
    assert twin.state.bench.sensors == case.state.bench.sensors
    assert twin.state.faults == ()
    mine, other = (first_modes(c.state.mesh, 6)[-3:] for c in (case, twin))
    assert other == pytest.approx(mine, rel=0.05)
    assert not np.array_equal(mine, other)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sound_structure_is_as_visible_as_its_twins(kind):
    over = []
    for seed in (14, 15, 16):
        case = conceal(seed, kind)
        over.append(misfit(case) / np.median([misfit(sound_twin(case, i)) for i in range(3)]))
    assert np.median(over) < 3
    gross = conceal(14, kind, "added-mass", 1.0)
    assert misfit(gross) > 10 * misfit(sound_twin(gross, 0))


def test_crosstalk_is_a_share_of_the_other_channel_whatever_it_measures():
    case = conceal(2, "frame", "crosstalk", 1.0)
    sensors = tuple(replace(s, order=1 + i % 2) for i, s in enumerate(case.state.bench.sensors))
    state = replace(case.state, bench=replace(case.state.bench, sensors=sensors), channels=(), faults=())
    mixed = OUTSIDE["crosstalk"](np.random.default_rng(0), state, 1.0)
    fault = mixed.channels[0]
    names = [s.name for s in sensors]
    one, other = (sensors[names.index(n)] for n in (fault.channel, fault.other))
    middle = 2 * np.pi * np.sqrt(np.prod(state.bench.band))
    assert fault.value == pytest.approx(0.8 * middle ** (one.order - other.order))
