r"""Modal identification: a modal model from measured FRFs of one driven place.

Poles come from common-denominator models of growing orders; those that stay put from order to order are kept (the
stabilisation diagram, `labnnum.stabilisation`). Frequencies and damping ratios are then refined together with real
residues, and with one mode below and one above the band that stand for all others, by least squares on the FRFs
relative to their noise. Two diagrams are made, with lines weighed by what is there and all alike: the first finds small
modes between large ones, noise that is the same on all lines misleads only the first. Poles of the second are taken
where they explain the FRFs much better. Complex residues, standard deviations: `labnnum.identification_residues`.

References
----------
P. Guillaume, P. Verboven, S. Vanlanduit, "Frequency-domain maximum likelihood identification of modal parameters with
confidence intervals", ISMA 23, 1998 (the LSCF estimator).
P. Verboven, "Frequency-domain system identification for modal analysis", VUB, 2002, chapter 5.
R. E. Kass, A. E. Raftery, "Bayes factors", Journal of the American Statistical Association 90, 1995 (much better).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import f as fisher

from labnnum.errors import EstimationError
from labnnum.frf import MOTION_ORDER, Frf
from labnnum.identification_residues import fit_residues
from labnnum.stabilisation import APART, Stabilisation, stabilisation, stable_poles
from labnnum.structures.modal import ModalStructure, Mode

HIDES = 0.01
"""Power of the noise in a line, of the response there, from which on the line does not tell what modes miss."""
CHANCE = 1e-4
"""Chance with which a mode beside the band is taken for needed where there is none."""
IDENTIFIED = 1e-6
"""What modes that were identified miss at least, by which they are known from those that were computed."""
PARTED = 0.5
"""Share of the misfit around a mode that two in its stead leave at most, to be taken for two."""
NOISE_LEFT = 2.0
"""Power over that of the stated noise which one mode leaves around it and two in its stead do not."""
BETTER = 10.0
"""Bayesian information criterion by which the poles of the second diagram must be better, very strong evidence."""
SMALLEST = 1e-6
"""Residue at the driven place, as a share of the largest, below which a mode is nodal there."""


@dataclass(frozen=True, eq=False)
class Identified:
    """A modal model and how well it fits.

    `frequency` (n,) in Hz and `damping_ratio` (n,) of the modes in the band; `structure` holds these and the two that
    stand for all others; `error` relative RMS over the responses; `fitted` (n_out, n_f) the receptances of `structure`.
    `nodal` (n_nodal,) are the frequencies in Hz of modes that hardly move the driven place: how much they move the
    others under a force there is known, how much under a force elsewhere is not, and their shapes are as large as the
    others' are in the median, as far as the scatter at the drive allows.
    """

    frequency: NDArray[np.float64]
    damping_ratio: NDArray[np.float64]
    structure: ModalStructure
    error: float
    fitted: NDArray[np.complex128]
    stabilisation: Stabilisation
    nodal: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    @property
    def shapes(self) -> NDArray[np.float64]:
        """Mass-normalised shapes of the modes in the band at the responses' places, 1/sqrt(kg), (n_places, n)."""
        modes = self.structure.modes
        have = np.array([float(m.frequency) for m in modes])
        own = [modes[int(np.argmin(np.abs(have - f)))] for f in self.frequency]
        return np.array([[float(v) for v in m.shape.values()] for m in own]).T


def identify(frf: Frf, order: int = 30, modes: int | None = None) -> Identified:
    """Modal model of FRFs with one input.

    Parameters
    ----------
    frf : Frf
        One input, at a place where a response is measured too; lines cut to the band of interest.
    order : int
        Highest order of the common denominator.
    modes : int, optional
        How many modes to keep; by default all that are stable over a quarter of the orders.

    Raises
    ------
    EstimationError
        If there are several inputs, no response at the driven place, or no stable pole.
    """
    if len(frf.inputs) != 1 or frf.inputs[0].role == "base":
        raise EstimationError(f"identification needs FRFs with one force, not {len(frf.inputs)} inputs")
    drive = frf.inputs[0].dof
    dofs = [c.dof for c in frf.outputs]
    if drive not in dofs:
        raise EstimationError(f"no response is measured at the driven place {drive!r}, which scales the mode shapes")
    h = receptance_of(frf)
    weight = _weight(frf, h)
    poles, damping, diagram = _poles(frf, h, weight, order, modes)
    omega, zeta, residue, nodal = _scaled(frf, h, weight, poles, damping, dofs.index(drive))
    shape = residue / np.sqrt(residue[:, [dofs.index(drive)]])
    built = tuple(
        Mode(float(w / 2 / np.pi), float(z), {d: float(v) for d, v in zip(dofs, row, strict=True)})
        for w, z, row in zip(omega, zeta, shape, strict=True)
    )
    fitted = (shape * shape[:, [dofs.index(drive)]]).T @ _basis(frf.omega, omega, zeta)
    missed, power = np.abs(fitted - h) ** 2, np.abs(h) ** 2
    structure = ModalStructure(built, error=max(_lack(frf, missed, power), IDENTIFIED))
    error = float(np.sqrt(np.mean(missed.sum(axis=1) / power.sum(axis=1))))
    return Identified(poles, damping, structure, error, fitted, diagram, omega[nodal] / (2 * np.pi))


def reciprocal(frf: Frf) -> Frf:
    """FRFs of one response to forces at several places, as of several responses to one force (Maxwell's reciprocity).

    A hammer that roves while one sensor stays measures what several sensors do while the force stays.

    Raises
    ------
    EstimationError
        If there are several responses, or an input or the response is no force or translation.
    """
    if len(frf.outputs) != 1:
        raise EstimationError(f"only FRFs of one response can be turned round, not of {len(frf.outputs)}")
    sensor = frf.outputs[0]
    if any(c.quantity != "force" or c.role == "base" for c in frf.inputs) or "angle" in sensor.quantity:
        raise EstimationError("FRFs are turned round between forces and translations only")
    force = replace(frf.inputs[0], name=f"force at {sensor.node}", node=sensor.node, direction=sensor.direction)
    sensors = tuple(replace(sensor, name=c.name, node=c.node, direction=c.direction) for c in frf.inputs)
    return replace(
        frf, value=np.swapaxes(frf.value, 0, 1), outputs=sensors, inputs=(force,), coherence=None, input_spectrum=None,
        variance=None if frf.variance is None else np.swapaxes(frf.variance, 0, 1), input_condition=None,
        shared=None if frf.shared is None else np.swapaxes(frf.shared, 0, 1),
    )  # fmt: skip


def _lack(frf: Frf, missed: NDArray, power: NDArray) -> float:
    """What modes miss beyond noise, relative, of squares (n_out, n_f) of what they miss and of the receptances.

    Without lines that noise hides: of displacements those next to rest are the largest, and the least known. What a
    window leaks is no lack of the modes.
    """
    if frf.estimator != "periodic" or frf.variance is None:
        return 0.0
    noise = power * frf.variance[:, 0] / np.maximum(np.abs(frf.value[:, 0]) ** 2, 1e-300)
    clear = noise.sum(axis=0) < HIDES * power.sum(axis=0)
    if 2 * np.count_nonzero(clear) < clear.size:
        clear[:] = True
    beyond = (missed - noise)[:, clear].sum(axis=1) / power[:, clear].sum(axis=1)
    return float(np.sqrt(max(np.mean(beyond), 0.0)))


def receptance_of(frf: Frf) -> NDArray[np.complex128]:
    """Displacement per force along the axes of the places, (n_out, n_f)."""
    s = 1j * frf.omega
    rise = np.array([MOTION_ORDER[c.quantity] for c in frf.outputs])
    sign = np.array([c.sign for c in frf.outputs]) * frf.inputs[0].sign
    return frf.value[:, 0] * sign[:, None] / s ** rise[:, None]


def _weight(frf: Frf, h: NDArray) -> NDArray[np.float64]:
    """One over the standard deviation of the receptances, a hundredth of the response at least."""
    size = np.abs(h)
    relative = (
        0.0 if frf.variance is None else np.sqrt(frf.variance[:, 0]) / np.maximum(np.abs(frf.value[:, 0]), 1e-300)
    )
    spread = np.sqrt(relative**2 + 0.01**2) * size + 0.02 * np.sqrt(np.mean(size**2, axis=1, keepdims=True)) * 0.2
    return 1.0 / spread


def _noise(frf: Frf, h: NDArray) -> NDArray[np.float64]:
    """One over the standard deviation of the receptances; where it is not stated, of a hundredth of the response."""
    if frf.variance is None:
        return _weight(frf, h)
    relative = np.sqrt(frf.variance[:, 0]) / np.maximum(np.abs(frf.value[:, 0]), 1e-300)
    return 1.0 / np.maximum(relative * np.abs(h), 1e-9 * np.abs(h).max())


# -------------------------------------------------------------------- poles


def _poles(
    frf: Frf, h: NDArray, weight: NDArray, order: int, modes: int | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], Stabilisation]:
    """Refined frequencies in Hz and damping ratios, and the diagram that they came from."""
    best: tuple[_Refined, Stabilisation] | None = None
    least = np.inf
    for even in (False, True):
        diagram = stabilisation(frf.omega, frf.value[:, 0], order, even)
        start = stable_poles(diagram, modes)
        if not len(start):
            continue
        found = _refined(frf.omega, h, weight, start)
        if _criterion(h, found) < least - BETTER:
            best, least = (found, diagram), _criterion(h, found)
    if best is None:
        raise EstimationError("no pole is stable from order to order: raise the order or narrow the band")
    found, diagram = best
    while modes is None or len(found[0]) < modes:
        parted = _parted(frf, h, weight, found)
        if parted is None or _criterion(h, parted) > _criterion(h, found) - BETTER:
            break
        found = parted
    return found[0], found[1], diagram


_Refined = tuple[NDArray[np.float64], NDArray[np.float64], float]
"""Frequencies (n,) in Hz, damping ratios (n,) and the weighted misfit."""


def _criterion(h: NDArray, found: _Refined) -> float:
    """Bayesian information criterion of modes, of a noise whose size is not known."""
    count = 2 * h.size
    unknown = len(found[0]) * (2 + len(h))
    return float(count * np.log(max(found[2], 1e-300) / count) + unknown * np.log(count))


def _parted(frf: Frf, h: NDArray, weight: NDArray, found: _Refined) -> _Refined | None:
    """Two close modes in the stead of the one around which most is left.

    None if that is what the weights grant; if the two leave more than half of it there, with real or with complex
    residues: two real modes that cancel one another stand for a complex one; if the one leaves no more than the noise
    where that is stated, or the two leave more: a law leaves something too; if one of the two has its half-power
    bandwidth between two lines; or if they are nearer than a quarter of it, as one mode is that moved from record to
    record.
    """
    frequency, damping, _ = found
    omega, own = frf.omega, 2 * np.pi * frequency
    power, step = _left(omega, h, weight, found), np.median(np.diff(frf.omega))
    near = [np.abs(omega - w) < d for w, d in zip(own, np.maximum(2 * damping * own, 2 * step), strict=True)]
    k = int(np.argmax([power[i].sum() for i in near]))
    if power[near[k]].mean() < 1:
        return None
    both = frequency[k] * (1 + 0.5 * damping[k] * np.array([-1.0, 1.0]))
    start = np.column_stack(
        [np.append(np.delete(frequency, k), both), np.append(np.delete(damping, k), damping[[k, k]])]
    )
    parted = _refined(omega, h, weight, start[np.argsort(start[:, 0])])
    pair = np.argsort(np.abs(parted[0] - frequency[k]))[:2]
    bandwidth = 4 * np.pi * (parted[1] * parted[0])[pair]
    if bandwidth.min() < step or 2 * np.pi * np.ptp(parted[0][pair]) < APART * bandwidth.mean():
        return None
    if _left(omega, h, weight, parted)[near[k]].sum() > PARTED * power[near[k]].sum():
        return None
    try:
        one, two = (_left_complex(frf, f)[:, near[k]] for f in (found, parted))
    except EstimationError:  # too few lines to tell
        return None
    if frf.variance is not None:
        noise = np.maximum(frf.variance[:, 0, near[k]], 1e-300)
        if not np.mean(two / noise) < NOISE_LEFT < np.mean(one / noise):
            return None
    size = np.mean(np.abs(frf.value[:, 0]) ** 2, axis=1, keepdims=True)
    return parted if np.sum(two / size) < PARTED * np.sum(one / size) else None


def _left_complex(frf: Frf, found: _Refined) -> NDArray[np.float64]:
    """Power that complex residues leave of each response on each line, (n_out, n_f)."""
    return np.abs(frf.value[:, 0] - fit_residues(frf, np.column_stack(found[:2])).fitted) ** 2


def _left(omega: NDArray, h: NDArray, weight: NDArray, found: _Refined) -> NDArray[np.float64]:
    """Weighted power that modes leave on each line (n_f,), a real value's in the mean over the responses."""
    mode, zeta = _with_rest(omega, 2 * np.pi * found[0], found[1])
    left = (h - _residues(omega, h, weight, mode, zeta).T @ _basis(omega, mode, zeta)) * weight
    return np.mean(np.abs(left) ** 2, axis=0) / 2


# -------------------------------------------------------------------- residues


def _basis(omega: NDArray, mode: NDArray, zeta: NDArray) -> NDArray[np.complex128]:
    return 1.0 / (mode[:, None] ** 2 + 2j * (zeta * mode)[:, None] * omega - omega**2)


def _residues(omega: NDArray, h: NDArray, weight: NDArray, mode: NDArray, zeta: NDArray) -> NDArray[np.float64]:
    """Real residues (n_modes, n_out) by weighted least squares, row by row."""
    basis = _basis(omega, mode, zeta)
    out = []
    for row, w in zip(h, weight, strict=True):
        a = (basis * w).T
        a = np.concatenate([a.real, a.imag])
        scale = np.linalg.norm(a, axis=0)
        b = np.concatenate([(row * w).real, (row * w).imag])
        out.append(np.linalg.lstsq(a / scale, b, rcond=None)[0] / scale)
    return np.array(out).T


def _scaled(
    frf: Frf, h: NDArray, weight: NDArray, poles: NDArray, damping: NDArray, at: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Frequencies in rad/s, damping ratios and residues (n, n_out) that a structure can have, and which are nodal.

    Those of the driven place, row `at`, are positive. A mode beside the band that would need a negative one, or that
    noise may have made, is left out. In the band such a mode gets the residue that makes its shape as large as the
    others' are in the median, its standard deviation at most, or more where that fits better; the others' residues at
    the drive are fitted anew.
    """
    omega = frf.omega
    mode, zeta = _with_rest(omega, 2 * np.pi * poles, damping)
    beside = np.arange(mode.size) % (mode.size - 1) == 0
    for i in (mode.size - 1, 0):
        if not _needed(omega, h, _noise(frf, h), mode, zeta, i):
            mode, zeta, beside = (np.delete(a, i) for a in (mode, zeta, beside))
    residue = _residues(omega, h, weight, mode, zeta)
    keep = ~beside | (residue[:, at] > 0)
    mode, zeta, residue, beside = mode[keep], zeta[keep], residue[keep], beside[keep]
    own = residue[:, at]
    least = np.full(own.size, SMALLEST * np.abs(own).max())
    nodal = own < least
    if nodal.any():
        basis = _basis(omega, mode, zeta) * weight[at]
        a = np.concatenate([basis.real, basis.imag], axis=1).T
        b = np.concatenate([(h[at] * weight[at]).real, (h[at] * weight[at]).imag])
        scatter = np.linalg.norm(np.linalg.pinv(a), axis=1) * np.sqrt(np.mean((a @ own - b) ** 2))
        others = np.linalg.norm(np.delete(residue, at, axis=1), axis=1)
        usual = np.median((others / np.sqrt(np.abs(own)))[~nodal]) if not nodal.all() else np.inf
        wanted = np.minimum(scatter, (others / usual) ** 2) if usual > 0 else scatter  # with a sensor elsewhere
        least[nodal] = np.clip(wanted[nodal], least[nodal], np.abs(own).max())
        scale = np.linalg.norm(a, axis=0)
        residue[:, at] = lsq_linear(a / scale, b, (least * scale, np.inf)).x / scale
    return mode, zeta, residue, nodal & ~beside


def _needed(omega: NDArray, h: NDArray, weight: NDArray, mode: NDArray, zeta: NDArray, i: int) -> bool:
    """Whether mode i explains more than chance lets one of as many residues explain.

    A mode beside the band that is none is small in the band and large at rest, where laws with a mean push.
    """

    def left(keep: NDArray) -> float:
        own = _residues(omega, h, weight, mode[keep], zeta[keep])
        return float(np.sum(np.abs((h - own.T @ _basis(omega, mode[keep], zeta[keep])) * weight) ** 2))

    every = np.arange(mode.size)
    whole, without = left(every), left(np.delete(every, i))
    free = max(2 * h.size - h.shape[0] * mode.size, 1)
    noise = max(whole / free, 0.5)  # of a real value, and no less than that by which it is weighed
    return bool(fisher.sf((without - whole) / h.shape[0] / noise, h.shape[0], free) < CHANCE)


def _with_rest(omega: NDArray, mode: NDArray, zeta: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies in rad/s and damping ratios of modes, and of one below and one above the band beside them."""
    low, high = 0.35 * omega[0], 3.0 * omega[-1]
    return np.concatenate([[low], mode, [high]]), np.concatenate([[0.05], zeta, [0.05]])


def _refined(omega: NDArray, h: NDArray, weight: NDArray, poles: NDArray) -> _Refined:
    """Frequencies and damping ratios that fit best when the residues follow (variable projection), and the misfit."""
    n = len(poles)

    def left(x: NDArray) -> NDArray:
        mode, zeta = _with_rest(omega, 2 * np.pi * poles[:, 0] * np.exp(x[:n]), poles[:, 1] * np.exp(x[n:]))
        r = (h - _residues(omega, h, weight, mode, zeta).T @ _basis(omega, mode, zeta)) * weight
        return np.concatenate([r.real.ravel(), r.imag.ravel()])

    reach = np.concatenate([np.full(n, 0.02), np.full(n, 2.0)])
    found = least_squares(left, np.zeros(2 * n), bounds=(-reach, reach), x_scale=reach, max_nfev=60)
    return poles[:, 0] * np.exp(found.x[:n]), poles[:, 1] * np.exp(found.x[n:]), 2 * float(found.cost)
