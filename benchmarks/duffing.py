"""The dissertation's Duffing oscillator swept up and down: harmonic balance beside equation 5.8 and time integration.

    python benchmarks/duffing.py

    x'' + 2 eps mu x' + x + eps alpha x^3 = eps K cos(omega t)

Equation 5.8 of Atalla (1996), by multiple scales, is of first order in eps: it is compared at eps = 0.1, as in the
example, and at a fifth and a twenty-fifth of it, where it should be that much nearer. Time integration (scipy, DOP853)
steps the frequency up and down from line to line, each from where the last ended, as a bench would.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from labnnum.harmonic import Curve, HarmonicBalance
from labnnum.nonlinear import Element
from labnnum.structures.chain import Chain, Link
from labnnum.structures.duffing import Duffing

MU, ALPHA, FORCE = 0.25, 1.5, 0.6
TURN = 2 * np.pi
DIRECTIONS = ("forward", "backward")


def balance(epsilon: float, harmonics: int = 5) -> HarmonicBalance:
    """The same equation for harmonic balance."""
    one = Chain({"1": 1.0}, (Link("1", "ground", 1.0, 2 * epsilon * MU),))
    spring = Element("cubic", np.ones(1), (epsilon * ALPHA,))
    return HarmonicBalance(one, "1:x", epsilon * FORCE, elements=[spring], harmonics=harmonics)


def branch(epsilon: float) -> Curve:
    """The response curve around its folds, detuning -1 to 2.5 as in the example."""
    return balance(epsilon).curve((1 - 1.2 * epsilon) / TURN, (1 + 2.7 * epsilon) / TURN, step=0.005)


def integrated(epsilon: float, omega: NDArray, direction: str, periods: int = 150) -> NDArray[np.float64]:
    """Amplitudes of the fundamental at each frequency, from a sweep in steps."""
    out, state = np.empty(omega.size), np.zeros(2)
    order = np.arange(omega.size) if direction == "forward" else np.arange(omega.size)[::-1]
    for i in order:
        w = omega[i]

        def rate(t: float, y: NDArray, w: float = w) -> list[float]:
            force = epsilon * (FORCE * np.cos(w * t) - 2 * MU * y[1] - ALPHA * y[0] ** 3)
            return [y[1], force - y[0]]

        period = 2 * np.pi / w
        setting = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-11}
        state = solve_ivp(rate, (0, periods * period), state, **setting).y[:, -1]
        t = np.arange(64) * period / 64
        out[i] = 2 / 64 * np.abs(np.fft.fft(solve_ivp(rate, (0, period), state, t_eval=t, **setting).y[0])[1])
    return out


def apart(a: NDArray, b: NDArray) -> str:
    """Median, 90 % quantile and largest relative difference in percent; on how many lines one has jumped already."""
    away = 100 * np.abs(a / b - 1)
    jumped = away > 50  # larger than any difference on one branch
    away = away[~jumped]
    return (
        f"{np.median(away):9.3f}{np.quantile(away, 0.9):9.3f}{away.max():9.3f}{int(jumped.sum()):7d} of {jumped.size}"
    )


def main() -> None:
    """Print both comparisons."""
    head = f"{'':44}{'median %':>9}{'90 %':>9}{'largest':>9}  one jumped"
    print(head)
    for epsilon in (0.1, 0.02, 0.004):
        curve, duffing = branch(epsilon), Duffing(epsilon=epsilon)
        sigma = np.linspace(-1.0, 2.5, 61)
        for direction in DIRECTIONS:
            ours = curve.swept((1 + epsilon * sigma) / TURN, direction)
            theirs = np.squeeze(duffing.amplitude(duffing.nominal, sigma, direction))
            print(f"equation 5.8, eps {epsilon:g}, {direction:24}{apart(theirs, ours)}", flush=True)
    curve, omega = branch(0.1), 1 + 0.1 * np.linspace(-1.0, 2.5, 61)
    for direction in DIRECTIONS:
        ours, marched = curve.swept(omega / TURN, direction), integrated(0.1, omega, direction)
        print(f"time integration, eps 0.1, {direction:17}{apart(marched, ours)}", flush=True)


if __name__ == "__main__":
    main()
