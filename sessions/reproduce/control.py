"""The dissertation's adaptive control of the driver's seat: a gain for the nominal, the estimated and the exact model.

An actuator stands between axle and seat, the disturbance comes from the wheel. Lengths of the cost are in mm, speeds in
mm/s, forces in N: the dissertation prints R/Q without units, and these make its "expensive" and "cheap" control what
the words say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.control import (
    StateSpace,
    cost_to_go,
    decay,
    free_response,
    kalman,
    lqr,
    mean_cost,
    observer_feedback,
    settling_time,
    state_feedback,
    state_space,
)
from labnnum.parameters import truncated_samples
from labnnum.structures.examples import truck
from labnnum.updating.many import refine_many
from labnnum.updating.training import Disturbance
from sessions.reproduce.cases import CASES
from sessions.reproduce.networks import Say, Training

ACTUATOR, WHEEL, SEAT = np.array([0.0, -1.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
RATIOS = (1e-2, 1e-6)
"""R/Q, expensive and cheap control."""

STATES = np.eye(6) * 1e6
"""Q: displacements in mm and velocities in mm/s, squared."""

DENSITY = np.array([[1.0]])
"""Of the wheel's force, N^2 s; the loops are linear, so only its ratio to the sensor's noise counts."""

SENSOR = 0.01
"""RMS of the sensor's noise below 20 Hz over that of the seat's motion without control."""

TIME = np.linspace(0.0, 20.0, 4001)


@dataclass(frozen=True, eq=False)
class Weights:
    """What a loop is judged by.

    Parameters
    ----------
    Q, R : ndarray
    sensor : ndarray, shape (1, 1)
        Density of the sensor's noise, m^2 s.
    """

    Q: NDArray[np.float64]
    R: NDArray[np.float64]
    sensor: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Gains:
    """A model with its regulator and its observer."""

    model: StateSpace
    K: NDArray[np.float64]
    L: NDArray[np.float64]


def system(theta: NDArray) -> StateSpace:
    """The truck with actuator, wheel force and measured seat."""
    return state_space(truck(), theta, ACTUATOR, WHEEL, SEAT)


def weights(ratio: float) -> Weights:
    """Weights for R/Q, with a sensor whose noise is set by the nominal seat's motion."""
    plant = system(truck().nominal)
    seat = mean_cost(plant.A, plant.C.T @ plant.C, plant.G @ DENSITY @ plant.G.T)
    return Weights(STATES, np.array([[ratio]]), np.array([[SENSOR**2 * seat / 40.0]]))


def gains(theta: NDArray, w: Weights) -> Gains:
    """Regulator and observer for a model at theta."""
    model = system(theta)
    return Gains(model, lqr(model, w.Q, w.R), kalman(model, DENSITY, w.sensor))


def judged(plant: StateSpace, g: Gains, w: Weights) -> dict[str, float]:
    """How a plant does under gains that were made for a model: state feedback, and observer with x3 measured."""
    full = state_feedback(plant, g.K)
    weight = w.Q + g.K.T @ w.R @ g.K
    kick = plant.G[:, 0]
    seat = free_response(full, kick, plant.C[0], TIME)
    loop = observer_feedback(plant, g.model, g.K, g.L)
    n = len(plant.A)
    whole = np.zeros((2 * n, 2 * n))
    whole[:n, :n], whole[n:, n:] = w.Q, g.K.T @ w.R @ g.K
    density = np.zeros((2 * n, 2 * n))
    density[:n, :n], density[n:, n:] = plant.G @ DENSITY @ plant.G.T, g.L @ w.sensor @ g.L.T
    start = np.concatenate([kick, np.zeros(n)])
    observed = free_response(loop, start, np.concatenate([plant.C[0], np.zeros(n)]), TIME)
    steady = decay(loop) > 0
    return {
        "lqr_unstable": float(decay(full) <= 0),
        "lqr_J": cost_to_go(full, weight, kick),
        "lqr_settling_s": settling_time(TIME, seat),
        "lqr_peak": float(np.abs(seat).max()),
        "lqg_unstable": float(not steady),
        "lqg_J": mean_cost(loop, whole, density),
        "lqg_settling_s": settling_time(TIME, observed) if steady else float("nan"),
        "lqg_peak": float(np.abs(observed).max()) if steady else float("nan"),
    }


def estimates(truth: NDArray, noise: float, seed: int, samples: int, say: Say) -> dict[str, NDArray]:
    """Parameters from x3/P by the network as printed, by ours, and refined."""
    case = CASES["truck-5-1frf"]()
    solver = case.solver()
    training = Training(case, solver, seed, say)
    printed = training.printed()
    ours = training.noisy(samples, 800, noise) if noise else training.clean(case.samples)
    value = Disturbance(noise).on(solver.frf(truth), seed, 30_000_000)
    first = ours(case.frequency, value)
    refined = np.vstack([refine_many(solver, value[i : i + 250], first[i : i + 250], approach=True, reach=2.0).value
                         for i in range(0, len(truth), 250)])  # fmt: skip
    return {"Ke, as printed": printed(case.frequency, value), "Ke, our network": first, "Ke, refined": refined}


def control(sets: int, seed: int, say: Say, noise: float = 0.01, samples: int = 10_000) -> dict[str, Any]:
    """K0, Ke and Ki over many parameter sets, for both R/Q; ready for JSON.

    Parameters
    ----------
    sets : int
        Parameter sets, drawn from the prior.
    noise : float
        On the FRF that the estimates come from, as a share of |H|.
    samples : int
        Training samples of our network.
    """
    free = truck().parameters
    truth = truncated_samples(free, np.random.default_rng(seed + 1).random((sets, len(free))))
    models: dict[str, NDArray] = {"K0": np.repeat(truck().nominal[None], sets, axis=0)}
    models |= estimates(truth, noise, seed, samples, say)
    models["Ki"] = truth
    out: dict[str, Any] = {"sets": sets, "noise": noise, "seed": seed, "ratios": []}
    for ratio in RATIOS:
        w = weights(ratio)
        rows: dict[str, list[dict[str, float]]] = {name: [] for name in models}
        nominal = gains(truck().nominal, w)
        for i, theta in enumerate(truth):
            plant = system(theta)
            for name, model in models.items():
                rows[name].append(judged(plant, nominal if name == "K0" else gains(model[i], w), w))
            if i % 50 == 49 or i + 1 == sets:
                say(f"R/Q {ratio:g}", i + 1, sets)
        out["ratios"].append({"ratio": ratio, "gains": {name: _summed(r, rows["Ki"]) for name, r in rows.items()}})
    return out


def _summed(rows: list[dict[str, float]], ideal: list[dict[str, float]]) -> dict[str, float]:
    """Counts, means over stable loops, and costs over those of the ideal gain."""
    column = {key: np.array([r[key] for r in rows]) for key in rows[0]}
    best = {key: np.array([r[key] for r in ideal]) for key in rows[0]}
    out: dict[str, float] = {}
    for kind in ("lqr", "lqg"):
        stable = np.isfinite(column[f"{kind}_J"]) & np.isfinite(best[f"{kind}_J"])
        ratio = column[f"{kind}_J"][stable] / best[f"{kind}_J"][stable]
        out[f"{kind}_unstable"] = int(column[f"{kind}_unstable"].sum())
        out[f"{kind}_J_mean"] = float(ratio.mean()) if stable.any() else float("nan")
        out[f"{kind}_J_worst"] = float(ratio.max()) if stable.any() else float("nan")
        for key in ("settling_s", "peak"):
            values = column[f"{kind}_{key}"]
            known = np.isfinite(values)
            out[f"{kind}_{key}_mean"] = float(values[known].mean()) if known.any() else float("nan")
        out[f"{kind}_not_settled"] = int(np.isnan(column[f"{kind}_settling_s"]).sum()) - out[f"{kind}_unstable"] * (
            kind == "lqg"
        )
    return out


def control_table(found: Mapping[str, Any]) -> str:
    """Text of the figures."""
    lines = [
        f"Driver's seat under control: {found['sets']} parameter sets, estimates from x3/P with"
        f" {100 * found['noise']:g} % noise (seed {found['seed']}); J over that of Ki, settling to 2 %, peak per N s"
    ]
    for at in found["ratios"]:
        for kind, title in (("lqr", "all states known"), ("lqg", "observer, x3 measured")):
            lines += ["", f"R/Q {at['ratio']:g}, {title}", f"{'gain':18}{'unstable':>9}{'J mean':>10}{'J worst':>10}"
                      f"{'settling s':>12}{'unsettled':>10}{'peak m':>11}"]  # fmt: skip
            for name, g in at["gains"].items():
                lines.append(
                    f"{name:18}{g[f'{kind}_unstable']:9d}{g[f'{kind}_J_mean']:10.5f}{g[f'{kind}_J_worst']:10.4f}"
                    f"{g[f'{kind}_settling_s_mean']:12.3f}{g[f'{kind}_not_settled']:10d}{g[f'{kind}_peak_mean']:11.3e}"
                )
    return "\n".join(lines) + "\n"
