"""The concealed truth's own finite elements, response and measurement chain against closed forms and scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sessions.prove.truth import channels, excite, fe
from sessions.prove.truth.bench import first_modes
from sessions.prove.truth.respond import Added, Plant, answer, complex_modes, steady, transfer
from sessions.prove.truth.state import ChannelFault

BETA_CLAMPED = np.array([1.875104069, 4.694091133, 7.854757438, 10.99554073])
BETA_FREE = np.array([4.730040745, 7.853204624, 10.99560784])


def beam(n=24, length=0.5, shear=np.inf, rotary=0.0, held=(1, 2), tension=0.0):
    bar = fe.Bar((0, 1), ("", ""), 2e6, 3.0, 0.4, shear, rotary)
    names = [str(i) for i in range(n + 1)]
    mesh = fe.line_mesh(np.linspace(0, length, n + 1), names, bar, (1, 2))
    return fe.Mesh(mesh.xy, mesh.bars, mesh.named, mesh.kept, frozenset(held), tension=tension)


def test_clamped_beam_has_the_closed_form_frequencies():
    exact = BETA_CLAMPED**2 / 0.5**2 * np.sqrt(3.0 / 0.4) / (2 * np.pi)
    assert first_modes(beam(), 4) == pytest.approx(exact, rel=5e-5)


def test_free_beam_floats_and_has_the_closed_form_frequencies():
    found = first_modes(beam(held=()), 5)
    exact = BETA_FREE**2 / 0.5**2 * np.sqrt(3.0 / 0.4) / (2 * np.pi)
    assert found[:2] == pytest.approx([0, 0], abs=0.05)
    assert found[2:] == pytest.approx(exact, rel=5e-5)


def test_frequencies_converge_at_the_fourth_order():
    exact = BETA_CLAMPED[2] ** 2 / 0.5**2 * np.sqrt(3.0 / 0.4) / (2 * np.pi)
    coarse, fine = (abs(first_modes(beam(n), 3)[2] - exact) for n in (4, 8))
    assert 10 < coarse / fine < 22


def test_simply_supported_timoshenko_beam_has_the_closed_form_frequencies():
    n, length, ei, mass, kga, rotary = 40, 0.5, 3.0, 0.4, 1e5, 2e-4
    held = (1, fe.DOFS_PER_NODE * n + 1)
    found = first_modes(beam(n, length, kga, rotary, held), 4) * 2 * np.pi
    for number, w in enumerate(found, 1):
        b = (number * np.pi / length) ** 2
        # ei b^2 - w^2 (mass + rotary b + mass ei b / kga) + w^4 mass rotary / kga = 0 (Huang, 1961)
        roots = np.roots([mass * rotary / kga, -(mass + rotary * b + mass * ei * b / kga), ei * b**2])
        assert w**2 == pytest.approx(roots.min(), rel=6e-4)


def test_a_beam_buckles_under_euler_load():
    load = np.pi**2 * 3.0 / (4 * 0.5**2)
    assert first_modes(beam(tension=-0.999 * load), 1)[0] < 0.05 * first_modes(beam(), 1)[0]


def test_a_frame_turned_round_has_the_same_frequencies():
    bar = fe.Bar((0, 1), ("", ""), 2e6, 3.0, 0.4)
    straight = fe.Mesh(
        np.array([[0.0, 0], [0.3, 0], [0.3, 0.4]]), (bar, fe.Bar((1, 2), ("", ""), 2e6, 3.0, 0.4)), {}, (0, 1, 2)
    )
    c, s = np.cos(0.7), np.sin(0.7)
    turned = fe.Mesh(straight.xy @ np.array([[c, s], [-s, c]]), straight.bars, {}, (0, 1, 2))
    held = frozenset((0, 1, 2))
    modes = [first_modes(fe.refine(fe.Mesh(m.xy, m.bars, {}, m.kept, held), 3), 5) for m in (straight, turned)]
    assert modes[0] == pytest.approx(modes[1], rel=1e-9)


def two_masses(added=()):
    M, K = np.diag([1.0, 0.5]), np.array([[3000.0, -1000.0], [-1000.0, 1000.0]])
    square, shape = complex_modes(M, K, np.zeros((2, 2)))
    viscous = 2 * 0.02 * np.sqrt(square.real)
    zero = np.zeros(2)
    plant = Plant(square, shape, viscous, np.eye(2), np.array([1.0, 0]), zero, zero, np.array([2, 2]), added)
    C = np.real(M @ shape @ np.diag(viscous) @ shape.T @ M)
    return plant, M, C, K


def integrate(M, C, K, force, rate):
    """Acceleration by an adaptive integrator, with the force between samples as its band-limited self."""
    n = force.size
    spectrum = np.fft.rfft(force)
    k = np.arange(spectrum.size)

    def f(t):
        return float(np.real(spectrum @ np.exp(2j * np.pi * k * t * rate / n) * 2 - spectrum[0])) / n

    size = len(M)
    inverse = np.linalg.inv(M)

    def slope(t, y):
        return np.concatenate([y[size:], inverse @ (np.eye(size)[0] * f(t) - C @ y[size:] - K @ y[:size])])

    times = np.arange(n) / rate
    found = solve_ivp(slope, (0, times[-1]), np.zeros(2 * size), t_eval=times, rtol=1e-9, atol=1e-12)
    return np.array([slope(t, y)[size:] for t, y in zip(times, found.y.T, strict=True)]).T


def blow(rate, n):
    t = np.arange(n) / rate
    return np.exp(-(((t - 0.1) / 0.02) ** 2))


def test_answer_from_rest_agrees_with_an_adaptive_integrator():
    plant, M, C, K = two_masses()
    force = blow(400.0, 400)
    exact = integrate(M, C, K, force, 400.0)
    found = answer(plant, force, 400.0, (0, 200))
    assert np.max(np.abs(found - exact)) < 1e-6 * np.max(np.abs(exact))


def test_an_attached_oscillator_is_the_system_with_one_more_mass():
    m, c, k = 0.05, 0.3, 120.0
    law = lambda s: (m * s**2 * (c * s + k) / (m * s**2 + c * s + k))[:, None, None]  # noqa: E731
    plant, M, C, K = two_masses((Added(np.array([[0.0, 1.0]]), law, True),))
    big = [np.zeros((3, 3)) for _ in range(3)]
    for matrix, small in zip(big, (M, C, K), strict=True):
        matrix[:2, :2] = small
    pair = np.array([[0, 0, 0], [0, 1, -1], [0, -1, 1.0]])
    exact = integrate(big[0] + np.diag([0, 0, m]), big[1] + c * pair, big[2] + k * pair, blow(400.0, 400), 400.0)
    found = answer(plant, blow(400.0, 400), 400.0, (0, 200))
    assert np.max(np.abs(found - exact[:2])) < 1e-6 * np.max(np.abs(exact))


def test_under_base_motion_an_added_mass_is_carried_along():
    M, K = np.diag([1.0, 0.5]), np.array([[3000.0, -1000.0], [-1000.0, 1000.0]])
    s = 2j * np.pi * np.linspace(1, 12, 30)
    law = lambda s: (0.2 * s**2)[:, None, None]  # noqa: E731
    found = []
    for mass, added in ((M, (Added(np.array([[0.0, 1.0]]), law, True),)), (M + np.diag([0, 0.2]), ())):
        square, shape = complex_modes(mass, K, np.zeros((2, 2)))
        one = np.ones(2)
        plant = Plant(square, shape, np.zeros(2), np.eye(2), -mass @ one, one, one, np.array([2, 2]), added)
        found.append(transfer(plant, s))
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_steady_is_where_the_answer_from_rest_ends():
    plant, *_ = two_masses()
    rng = np.random.default_rng(3)
    period = excite.odd_multisine(rng, 512, 200.0, (2, 40))
    long = answer(plant, np.tile(period, 20), 200.0, (0, 100))
    assert np.roll(long[:, -612:-100], 412, 1) == pytest.approx(
        steady(plant, period, 200.0), abs=1e-5 * np.max(np.abs(long))
    )


def test_far_modes_enter_by_their_series():
    mesh = beam(30)
    M, K, D = fe.assemble(mesh)
    a = mesh.active
    square, shape = complex_modes(M[np.ix_(a, a)], K[np.ix_(a, a)], 0 * D[np.ix_(a, a)])
    row = np.zeros((1, a.size))
    row[0, -2] = 1
    zero = np.zeros(a.size)
    plant = Plant(square, shape, 0.01 * np.sqrt(square.real), row, row[0], zero, np.zeros(1), np.array([0]))
    s = 2j * np.pi * np.linspace(5, 300, 40)
    full = np.sum((row @ shape) ** 2 / (square + s[:, None] ** 2 + s[:, None] * plant.viscous), axis=1)
    assert transfer(plant, s)[0] == pytest.approx(full, rel=6e-4)


def test_odd_multisine_leaves_even_lines_and_one_odd_line_in_four_empty():
    signal = excite.odd_multisine(np.random.default_rng(1), 1024, 512.0, (10, 200))
    spectrum = np.abs(np.fft.rfft(signal))
    used = np.flatnonzero(spectrum > 1e-6 * spectrum.max())
    assert np.all(used % 2 == 1)
    assert np.std(signal) == pytest.approx(1)
    odd = np.arange(21, 400, 2)
    assert np.isin(odd, used).sum() == pytest.approx(0.75 * odd.size, abs=2)


@pytest.mark.parametrize(("reach", "rate"), [(100.0, 400.0), (350.0, 1400.0)])
def test_a_hammer_blow_reaches_as_far_as_asked(reach, rate):
    blow = excite.pulse(np.random.default_rng(2), 4096, rate, 0.3, reach)
    spectrum = np.abs(np.fft.rfft(blow))
    at = np.interp(reach, np.fft.rfftfreq(4096, 1 / rate), spectrum / spectrum[0])
    assert 0.03 < at < 0.25
    assert spectrum[-1] < 1e-3 * spectrum[0]


def sine(rate=1000.0, n=4000, f=20.0):
    t = np.arange(n) / rate
    return t, np.sin(2 * np.pi * f * t) * np.minimum(1, t / 0.5)


def spoiled(kind, value, data, rate=1000.0, other=""):
    names = tuple(f"c{i}" for i in range(len(data)))
    peak = np.max(np.abs(data), axis=1)
    fault = ChannelFault(kind, "c1", value, other)
    return channels.spoil((fault,), names, np.array(data), rate, peak, ((0, data[0].size),))


def test_a_late_channel_is_late():
    t, x = sine()
    out = spoiled("delay", 0.003, [x, x])
    assert out[1, 2000:] == pytest.approx(np.sin(2 * np.pi * 20 * (t[2000:] - 0.003)), abs=1e-3)
    assert np.array_equal(out[0], x)


def test_a_capacitor_leads_and_lowers():
    t, x = sine()
    out = spoiled("highpass", 10.0, [x, x])[1, 2000:]
    H = 20j / (20j + 10)
    assert out == pytest.approx(np.imag(H * np.exp(2j * np.pi * 20 * t[2000:])), abs=2e-3)


def test_a_rail_holds_and_cables_swap():
    _, x = sine()
    y = np.roll(x, 50)
    assert np.max(spoiled("clipping", 0.6, [y, x])[1]) == pytest.approx(0.6 * x.max())
    out = spoiled("exchange", 1.0, [x, y], other="c0")
    assert np.array_equal(out[0], y)
    assert np.array_equal(out[1], x)
    assert spoiled("crosstalk", 0.1, [y, x], other="c0")[1] == pytest.approx(x + 0.1 * y)


def test_the_converter_holds_the_range_and_rounds_to_steps():
    rng = np.random.default_rng(5)
    data = np.array([np.linspace(-2, 2, 101)])
    out = channels.digitise(rng, data, np.ones(1), np.zeros(1), np.ones(1), 8)
    steps = out * 2**7
    assert steps == pytest.approx(np.round(steps), abs=1e-9)
    assert out.min() == -1
    assert out.max() == 1 - 2**-7


def test_the_truth_shares_no_code_with_the_tool():
    import ast
    from pathlib import Path

    folder = Path(channels.__file__).parents[1]
    allowed = {"labnnum.errors"}
    files = [
        f for f in folder.rglob("*.py") if not f.name.startswith("real")
    ]  # recordings by others: there is no truth to make
    assert len(files) > 12
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [a.name for a in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                top = name.split(".")[0]
                assert top not in ("drivers", "labnnum") or name in allowed, f"{file.name} imports {name}"
                assert top != "sessions" or name.startswith("sessions.prove"), f"{file.name} imports {name}"
