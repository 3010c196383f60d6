"""Time simulation against closed forms and the frequency domain."""

import numpy as np
import pytest
from scipy.signal import lsim

from labnnum.errors import ChannelError, EstimationError, ModelError
from labnnum.recording import Channel
from labnnum.response import frf
from labnnum.simulation import Simulation, simulate
from labnnum.structures.chain import Chain, Link
from labnnum.structures.quantities import Damping
from labnnum.system import System, system

PUSH = Channel("f", "force", "reference", "1", "x")
TIP = Channel("a", "acceleration", node="2", direction="x")


def chain(c1=3.0, c2=1.0, ground=True) -> Chain:
    links = [Link("1", "2", 5e4, c2)]
    if ground:
        links.append(Link("1", "ground", 8e4, c1))
    return Chain(masses={"1": 2.0, "2": 1.0}, links=tuple(links))


def outputs():
    return [
        TIP,
        Channel("d", "displacement", node="1", direction="-x"),
        Channel("v", "velocity", node="2", direction="x"),
    ]


def one(m=1.0, c=0.0, k=0.0) -> System:
    e = np.ones((1, 1))
    return System(m * e, c * e, k * e, e, e, 0 * e, 0 * e, 0 * e)


def test_system_has_the_frf_of_the_structure():
    f = np.linspace(0.5, 100, 41)
    made = system(chain(), [], outputs(), [PUSH])
    np.testing.assert_allclose(made.frf(f), frf(chain(), [], f, outputs(), [PUSH]), rtol=1e-12)


@pytest.mark.parametrize(("order", "tolerance"), [(2, 1e-2), (4, 2e-4), (6, 3e-6), (8, 5e-7)])
def test_periodic_input_is_exact_at_the_order_of_the_hold(order, tolerance):
    n, rate, line = 2048, 2048.0, 80
    x = np.cos(2 * np.pi * line * np.arange(40 * n) / n)
    y = simulate(system(chain(100, 60), [], outputs(), [PUSH]), x, 1 / rate, order)
    gain = np.fft.rfft(y[:, -2 * n : -n])[:, line] / np.fft.rfft(x[-n:])[line]
    exact = frf(chain(100, 60), [], [float(line)], outputs(), [PUSH])[:, 0, 0]
    assert np.max(np.abs(gain / exact - 1)) < tolerance


def test_first_order_hold_agrees_with_scipy():
    rng = np.random.default_rng(3)
    u = rng.standard_normal(400)
    t = np.arange(400) * 1e-3
    y = simulate(one(2.0, 15.0, 8e3), u, 1e-3, order=2)[0]
    state = ([[0, 1], [-4e3, -7.5]], [[0], [0.5]], [[1, 0]], [[0]])
    expected = lsim(state, u, t)[1]
    np.testing.assert_allclose(y, expected, atol=1e-12 * np.abs(expected).max() + 1e-13)


@pytest.mark.parametrize("damping", [0.0, 40.0, 200.0])
def test_free_decay_critical_and_overdamped(damping):
    # an impulse of unit area within one step leaves velocity 1/m
    m, k, step = 1.0, 1e4, 1e-4
    u = np.zeros(3000)
    u[1] = 1 / step
    y = simulate(one(m, damping, k), u, step, order=2)[0]
    t = np.arange(3000) * step - step
    s = np.roots([m, damping, k])
    critical = t * np.exp(-100 * t)
    exact = critical if damping == 200.0 else ((np.exp(s[0] * t) - np.exp(s[1] * t)) / (s[0] - s[1])).real
    # the triangle of two steps is no impulse: (s T)^2/12 for the fastest pole, s T = 0.02
    np.testing.assert_allclose(y[10:], exact[10:], atol=1e-4 * np.abs(exact).max())


def test_free_structure_drifts_as_a_rigid_body():
    free = system(chain(ground=False), [], [TIP], [PUSH])
    y = simulate(free, np.full(20000, 3.0), 1e-3, order=2)
    assert y[0, -5000:-10].mean() == pytest.approx(1.0, rel=1e-3)  # 3 N on 3 kg


def test_streaming_gives_the_same_bits():
    rng = np.random.default_rng(1)
    u = rng.standard_normal((1, 5000))
    made = system(chain(), [], outputs(), [PUSH])
    whole = Simulation(made, 1e-3)
    parts = Simulation(made, 1e-3)
    y = whole.run(u)
    pieces = [parts.run(u[:, a:b]) for a, b in [(0, 1), (1, 3), (3, 1000), (1000, 4999), (4999, 5000)]]
    joined = np.hstack(pieces)
    assert joined.shape == y.shape
    np.testing.assert_allclose(joined, y, rtol=1e-12, atol=1e-15)


def test_base_motion_gives_absolute_outputs():
    structure = Chain(
        masses={"1": 2.0, "2": 1.0}, links=(Link("1", "ground", 8e4, 20.0), Link("1", "2", 5e4, 9.0)), base="x"
    )
    base = Channel("b", "acceleration", "base", direction="x")
    out = [TIP, base, Channel("d", "displacement", node="2", direction="x")]
    f = np.array([3.0, 20.0, 71.0])
    np.testing.assert_allclose(system(structure, [], out, [base]).frf(f), frf(structure, [], f, out, [base]), rtol=1e-9)


def test_structural_damping_loses_the_same_at_resonance():
    structure = Chain(masses={"1": 1.0}, links=(Link("1", "ground", 4e4),), damping=Damping("structural", eta=0.02))
    tip = Channel("a", node="1", direction="x")
    omega = 200.0
    f = [omega / 2 / np.pi]
    made = system(structure, [], [tip], [PUSH]).frf(f)
    np.testing.assert_allclose(made, frf(structure, [], f, [tip], [PUSH]), rtol=1e-9)


def test_massless_coordinates_follow():
    # a Maxwell branch: spring to a massless point that a dashpot ties to ground
    M = np.diag([1.0, 0.0])
    C = np.diag([1.0, 30.0])
    K = np.array([[5e3 + 2e3, -2e3], [-2e3, 2e3]])
    load = np.array([[1.0], [0.0]])
    row, none = np.array([[1.0, 0.0]]), np.zeros((1, 2))
    made = System(M, C, K, load, none, none, row, np.zeros((1, 1)))
    n, rate, line = 1024, 1024.0, 13
    x = np.cos(2 * np.pi * line * np.arange(20 * n) / n)
    y = simulate(made, x, 1 / rate)
    gain = np.fft.rfft(y[0, -n:])[line] / np.fft.rfft(x[-n:])[line]
    assert gain == pytest.approx(made.frf([float(line)])[0, 0, 0], rel=1e-6)


def test_what_cannot_be_simulated_is_said():
    with pytest.raises(ModelError, match="unstable"):
        Simulation(one(1, 0, -5.0), 1e-3)
    with pytest.raises(EstimationError, match="even"):
        Simulation(one(), 1e-3, order=3)
    with pytest.raises(ChannelError, match="not a motion"):
        system(chain(), [], [PUSH], [PUSH])
    with pytest.raises(ModelError, match="degree of freedom"):
        system(chain(), [], [Channel("a", node="9", direction="x")], [PUSH])
