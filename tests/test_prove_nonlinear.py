"""Nonlinear truth as a whole: marched laws with exact outputs against an adaptive integrator of the full structure."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labnnum.errors import ConfigError
from sessions.prove.cases import BESIDE_LAWS, KINDS, LAWS, conceal, fits, make_case
from sessions.prove.referee import misfit
from sessions.prove.run import TOOL, answer
from sessions.prove.suite import Ticket, draw
from sessions.prove.truth import fe, march
from sessions.prove.truth.nonlinear import coarser, coupling, finer, moving_alike, nonlinear, stretch, stretched, stroke
from sessions.prove.truth.physics import STRUCTURAL
from sessions.prove.truth.respond import answers
from sessions.prove.truth.session import ramped
from sessions.prove.truth.state import LawTerm, plant
from sessions.prove.visible import misfits


def chain_state(k3):
    state = conceal(31, "chain", "cubic-stiffness", 0.5).state
    term = state.laws[0]
    return replace(state, laws=(LawTerm(march.CUBIC, (k3,), term.row),))


def blow(n, rate):
    return 60 * np.exp(-(((np.arange(n) / rate - 0.15) / 0.02) ** 2))


def adaptive(state, signal, rate):
    """Accelerations of the sensors by integrating every degree of freedom of the fine mesh."""
    mesh = state.mesh
    a = mesh.active
    M, K, _ = (x[np.ix_(a, a)] for x in fe.assemble(mesh))
    whole = plant(state)
    shape = np.real(whole.shape)
    C = M @ shape @ np.diag(whole.viscous) @ shape.T @ M
    w, k3 = state.laws[0].row[a], state.laws[0].constants[0]
    over = 64
    fine = finer(signal, over)
    times = np.arange(fine.size) / (rate * over)
    inverse, n = np.linalg.inv(M), a.size

    def slope(t, y):
        f = whole.load * np.interp(t, times, fine) - w * k3 * (w @ y[:n]) ** 3
        return np.concatenate([y[n:], inverse @ (f - C @ y[n:] - K @ y[:n])])

    at = np.arange(signal.size) / rate
    y = solve_ivp(slope, (0, at[-1]), np.zeros(2 * n), t_eval=at, method="DOP853", rtol=1e-8, atol=1e-11).y
    acceleration = np.array([slope(t, x)[n:] for t, x in zip(at, y.T, strict=True)]).T
    motion = {2: acceleration, 1: y[n:], 0: y[:n]}
    return np.array([row @ motion[order] for row, order in zip(whole.outputs, whole.orders, strict=True)])


def test_outputs_agree_with_the_whole_structure_integrated():
    state = chain_state(0.0)
    rate, n = 16 * state.bench.band[1], 900
    z = march.march(
        coupling(plant(state), state.laws[0].row[None, state.mesh.active], state.bench.band[1]),
        march.Laws(np.array([march.CUBIC]), np.zeros((1, 8))),
        blow(n, rate),
        1 / rate,
    )[0]
    stiffness = abs(state.mesh.bars[0].axial) / 0.1
    state = chain_state(0.5 * stiffness / np.max(np.abs(z)) ** 2)
    found, exact = nonlinear(state, blow(n, rate), rate), adaptive(state, blow(n, rate), rate)
    linear = answers(plant(state), [blow(n, rate)], rate, (0, rate / 2))[0]
    used = slice(5, n - 60)
    size = np.max(np.abs(exact))
    assert np.max(np.abs(linear - exact)[:, used]) > 0.05 * size
    assert np.max(np.abs(found - exact)[:, used]) < 3e-3 * size


def test_a_law_of_no_strength_changes_nothing():
    state = chain_state(0.0)
    rate = 3 * state.bench.band[1]
    found = nonlinear(state, blow(2000, rate), rate)
    assert found == pytest.approx(answers(plant(state), [blow(2000, rate)], rate, (0, rate / 2))[0], abs=1e-9)


def test_finer_then_coarser_gives_the_signal_back():
    t = np.arange(900) / 100
    x = np.exp(-(((t - 4) / 0.6) ** 2)) * np.sin(2 * np.pi * 20 * t)
    assert coarser(finer(x, 7), 7) == pytest.approx(x, abs=1e-9)
    stuck = np.clip(t - 4, 0, 1)
    assert np.max(np.abs(coarser(np.repeat(stuck, 4), 4)[:300])) < 1e-3


@pytest.mark.parametrize("law", ["cubic-stiffness", "coulomb-friction"])
def test_distortion_follows_the_level_as_the_law_says(law):
    case = make_case(5, "chain", law, 0.8)
    n, odd = case.plan.samples, []
    for run in case.runs[::2]:
        kept = run.data[:, case.plan.drop * n :].reshape(len(run.data), -1, n).mean(axis=1)
        power = np.abs(np.fft.rfft(kept, axis=1)) ** 2
        low, high = (int(f * n / case.plan.rate) for f in case.state.bench.band)
        lines = np.arange(low + low % 2 + 1, high, 2)
        used = power[0, lines] > 0.01 * power[0].max()
        odd.append(np.mean(power[1:, lines[~used]]) / np.mean(power[1:, lines[used]]))
    grows = {"cubic-stiffness": odd[2] > 10 * odd[1], "coulomb-friction": odd[1] > odd[2]}
    assert grows[law]


@pytest.mark.parametrize(("kind", "law"), [(k, n) for k in KINDS for n in LAWS])
def test_every_law_sits_somewhere_and_is_told_in_the_truth(kind, law):
    if not fits(law, kind, "multisine"):
        pytest.skip("makes no sense there")
    case = conceal(17, kind, law, 0.5)
    fault = case.truth["faults"][0]
    assert fault["mechanism"] == law
    assert fault["place"]["kind"] in ("ground", "joint")
    assert fault["parameters"]
    assert len(case.state.laws) == 1


def test_a_law_takes_no_more_stiffness_than_is_there_whatever_stands_beside_it():
    beside = {"support-compliance": 0.8, "quadratic-stiffness": 0.8}
    for faults in (tuple(beside), tuple(reversed(beside))):
        state = conceal(4900000057, "frame", faults, tuple(beside[f] for f in faults)).state
        k2, last = state.laws[0].constants
        assert 2 * abs(k2) * last == pytest.approx(stretch(state, state.laws[0].row[None])[2], rel=1e-3)
        assert tuple(f.mechanism for f in state.faults) == faults


def test_a_structure_that_runs_away_cannot_be_measured_and_is_listed(tmp_path, monkeypatch):
    state = chain_state(-1e18)
    rate = 4 * state.bench.band[1]
    with pytest.raises(FloatingPointError, match="runs away"):
        nonlinear(state, blow(600, rate), rate)
    monkeypatch.setattr(Ticket, "conceal", lambda self: replace(conceal(31, "chain", "cubic-stiffness"), state=state))
    ticket = Ticket("case0001", 31, "nonlinear", "chain", ("cubic-stiffness",), (0.5,), "hammer")
    assert answer(ticket, tmp_path, False, TOOL) == "case0001"
    assert "not measured" in (tmp_path / "answers" / "case0001" / "error.txt").read_text()
    assert np.isnan(misfits(ticket)["whole"])


def test_friction_shows_to_the_referee_and_a_faint_spring_does_not():
    faint, strong = (conceal(3, "chain", law, x) for law, x in (("quadratic-stiffness", 0.0), ("stick-slip", 1.0)))
    assert misfit(strong) > 10 * misfit(faint)


def test_the_nonlinear_suite_holds_every_family_and_only_what_can_stand_together():
    tickets = draw(120, 3, "nonlinear")
    assert {t.family for t in tickets} == {"null", "nonlinear", "channel", "outside", "double"}
    assert {f for t in tickets for f in t.faults} >= set(LAWS)
    for ticket in tickets[:40]:
        assert [f.mechanism for f in ticket.conceal().state.faults] == list(ticket.faults)


def test_a_law_does_not_stand_beside_what_time_marching_lacks():
    with pytest.raises(ConfigError, match="beside a nonlinear law"):
        conceal(1, "chain", ("cubic-stiffness", "viscoelastic"))


@pytest.mark.parametrize("excitation", ["multisine", "sweep", "hammer"])
def test_a_sound_structure_leaves_little_under_any_excitation_and_friction_much(excitation):
    sound = misfit(conceal(41, "chain", excitation=excitation), marched=True)
    rubbing = misfit(conceal(41, "chain", "coulomb-friction", 0.8, excitation))
    assert rubbing > 10 * sound


def test_the_referee_sees_the_same_structure_in_runs_as_in_exact_responses():
    for seed in (41, 42):
        case = conceal(seed, "chain", "added-mass", 0.6)
        exact, runs = misfit(case), misfit(case, marched=True)
        assert 0.25 < runs / exact < 4


def test_storeys_of_a_frame_move_as_one_and_nodes_along_a_beam_do_not():
    state = conceal(7, "frame", "coulomb-friction", 0.5).state
    height = {name: state.bench.coarse.xy[i][1] for name, i in state.bench.coarse.named.items()}
    top = [name for name, y in height.items() if y == max(height.values())]
    first, others = top[0], {("ground", name) for name in top[1:]}
    assert len(others) >= 2

    def alike(axis):
        row = np.zeros(state.mesh.size)
        row[state.mesh.dof(first, axis)] = 1.0
        place = {"kind": "ground", "id": first, "to": None}
        return {(p["kind"], p["id"]) for p in moving_alike(state, row, place)}

    assert alike(0) == others  # sway
    assert not alike(2) & others  # each turns by itself


def test_a_slider_that_no_run_makes_slip_may_be_called_the_spring_that_it_is():
    case = conceal(12, "chain", "stick-slip", 0.6)
    term = case.state.laws[0]
    assert ("hysteresis" in [name for name, _ in case.told[0].accept]) is (term.constants[2] == 5.0)
    held = replace(term, constants=(term.constants[0], 1e6 * term.constants[1], *term.constants[2:]))
    case = replace(case, state=replace(case.state, laws=(held,)))
    spring = "ground-stiffness" if case.state.faults[0].place["kind"] == "ground" else "joint-stiffness"
    assert (spring, case.state.faults[0].place) in case.told[0].accept
    signal = np.random.default_rng(3).standard_normal(400)
    small, large = (stretched(case.state, level * signal, 3 * case.state.bench.band[1])[0] for level in (1e-3, 1e-2))
    assert large == pytest.approx(10 * small, rel=1e-6)  # a spring
    assert small < stroke(held)
    assert stroke(replace(term, kind=march.CUBIC)) == np.inf


BESIDE = [
    (kind, beside) for kind in KINDS for beside in (None, *sorted(BESIDE_LAWS & set(STRUCTURAL)))
    if beside is None or fits(beside, kind, "multisine")
]  # fmt: skip


@pytest.mark.parametrize(("kind", "beside"), BESIDE)
def test_the_march_and_the_exact_transfers_know_one_structure(kind, beside):
    """The stretch of the law as it was marched is what input and force make by the transfers of the outputs."""
    faults = ("cubic-stiffness",) if beside is None else ("cubic-stiffness", beside)
    state = conceal(44, kind, faults, 0.9).state
    whole, law = plant(state), state.laws[0]
    row = law.row[None, state.mesh.active]
    rate, n = 4 * state.bench.band[1], 6000
    signal = ramped(np.random.default_rng(1).standard_normal(n))
    signal = np.fft.irfft(np.fft.rfft(signal) * (np.arange(n // 2 + 1) < n // 8), n)
    over = 12
    stretch, _, force = march.march(
        coupling(whole, row, state.bench.band[1]),
        march.Laws(np.array([law.kind]), np.array([[*law.constants, *np.zeros(8 - len(law.constants))]])),
        finer(signal, over), 1 / (rate * over),
    )  # fmt: skip
    seen = replace(whole, outputs=row, carried_out=np.zeros(1), orders=np.zeros(1, int), extras=())
    pushed = replace(seen, load=row[0], carried=0 * whole.carried)
    made = (
        answers(seen, [signal], rate, (0.0, rate / 2))[0][0]
        - answers(pushed, [coarser(force[0], over)], rate, (0.0, rate / 2))[0][0]
    )
    error = np.linalg.norm(made - stretch[0, ::over]) / np.linalg.norm(made)
    assert error < 1e-3
