r"""Modal identification: a modal model from measured FRFs of one driven place.

Poles come from a common-denominator model in the discrete frequency domain, fitted at growing orders; those that stay
put from order to order are kept (the stabilisation diagram). Frequencies and damping ratios are then refined together
with real residues, and with one mode below and one above the band that stand for all others, by least squares on the
FRFs relative to their noise.

References
----------
P. Guillaume, P. Verboven, S. Vanlanduit, "Frequency-domain maximum likelihood identification of modal parameters with
confidence intervals", ISMA 23, 1998 (the LSCF estimator).
P. Verboven, "Frequency-domain system identification for modal analysis", VUB, 2002, chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import f as fisher

from labnnum.errors import EstimationError
from labnnum.frf import MOTION_ORDER, Frf
from labnnum.structures.modal import ModalStructure, Mode

FREQUENCY_STAYS, DAMPING_STAYS = 0.01, 0.2
"""Relative change from one order to the next up to which a pole counts as stable."""

HIDES = 0.01
"""Power of the noise in a line, of the response there, from which on the line does not tell what modes miss."""
CHANCE = 1e-4
"""Chance with which a mode beside the band is taken for needed where there is none."""
IDENTIFIED = 1e-6
"""What modes that were identified miss at least, by which they are known from those that were computed."""
SMALLEST = 1e-6
"""Residue at the driven place, as a share of the largest, below which a mode is nodal there."""


@dataclass(frozen=True, eq=False)
class Stabilisation:
    """Poles of every order: `order` (n,), `frequency` (n,) in Hz, `damping_ratio` (n,), `stable` (n,)."""

    order: NDArray[np.int64]
    frequency: NDArray[np.float64]
    damping_ratio: NDArray[np.float64]
    stable: NDArray[np.bool_]


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
    diagram = stabilisation(frf.omega, frf.value[:, 0], order)
    poles = stable_poles(diagram, modes)
    if not len(poles):
        raise EstimationError("no pole is stable from order to order: raise the order or narrow the band")
    poles, damping = _refined(frf.omega, h, weight, poles)
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


def stabilisation(omega: NDArray, value: NDArray, order: int) -> Stabilisation:
    """Poles of common-denominator models of even orders up to `order`, and which repeat from order to order."""
    rows: list[tuple[int, float, float, bool]] = []
    before: list[tuple[float, float]] = []
    for n in range(4, order + 1, 2):
        found = lscf(omega, value, n)
        here = []
        for f, z in found:
            near = [(g, y) for g, y in before if abs(f - g) < FREQUENCY_STAYS * f]
            stays = any(abs(z - y) < DAMPING_STAYS * max(z, 1e-4) for _, y in near)
            rows.append((n, f, z, bool(stays)))
            here.append((f, z))
        before = here
    if not rows:
        empty = np.zeros(0)
        return Stabilisation(empty.astype(int), empty, empty, empty.astype(bool))
    n, f, z, s = zip(*rows, strict=True)
    return Stabilisation(np.array(n), np.array(f), np.array(z), np.array(s, bool))


def lscf(omega: NDArray, value: NDArray, order: int) -> list[tuple[float, float]]:
    """Frequency (Hz) and damping ratio of the decaying poles of one order, by least squares in the z-domain.

    Parameters
    ----------
    omega : ndarray, shape (n_f,)
    value : ndarray, shape (n_out, n_f)
    """
    span = omega[-1] - omega[0]
    step = np.pi / span * 0.95
    z = np.exp(-1j * np.outer(np.arange(order + 1), (omega - omega[0]) * step))
    total = np.zeros((order + 1, order + 1))
    for row in value:
        w = 1.0 / (np.abs(row) + 0.05 * np.sqrt(np.mean(np.abs(row) ** 2)))
        x, y = z * w, -z * (w * row)
        r, s, t = np.real(x.conj() @ x.T), np.real(x.conj() @ y.T), np.real(y.conj() @ y.T)
        total += t - s.T @ np.linalg.solve(r + 1e-10 * np.trace(r) / len(r) * np.eye(len(r)), s)
    inner = np.linalg.lstsq(total[:-1, :-1], -total[:-1, -1], rcond=1e-12)[0]
    roots = np.roots(np.append(inner, 1.0)[::-1])
    roots = roots[np.abs(roots) > 0]
    s = -np.log(roots) / step
    poles = s.real + 1j * (s.imag + omega[0])
    out = []
    for p in poles:
        inside = omega[0] < p.imag < omega[-1]
        if p.real < 0 and inside and -p.real < 0.3 * abs(p):
            out.append((float(abs(p) / 2 / np.pi), float(-p.real / abs(p))))
    return sorted(out)


def stable_poles(diagram: Stabilisation, modes: int | None = None) -> NDArray[np.float64]:
    """(n, 2) frequency and damping ratio of the poles that repeat, the medians of their columns of the diagram."""
    pick = np.flatnonzero(diagram.stable)
    if not pick.size:
        return np.zeros((0, 2))
    order = pick[np.argsort(diagram.frequency[pick])]
    f = diagram.frequency[order]
    groups = np.split(order, np.flatnonzero(np.diff(f) > 1.5 * FREQUENCY_STAYS * f[:-1]) + 1)
    half = 0.25 * np.unique(diagram.order).size
    groups = [g for g in groups if g.size >= half] or [max(groups, key=len)]
    if modes is not None:
        groups = sorted(groups, key=len)[-modes:]
    out = [(np.median(diagram.frequency[g]), np.median(diagram.damping_ratio[g])) for g in groups]
    return np.array(sorted(out))


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
    low, high = 0.35 * omega[0], 3.0 * omega[-1]
    mode = np.concatenate([[low], 2 * np.pi * poles, [high]])
    zeta = np.concatenate([[0.05], damping, [0.05]])
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


def _refined(
    omega: NDArray, h: NDArray, weight: NDArray, poles: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies and damping ratios that fit best when the residues follow (variable projection)."""
    n = len(poles)
    low, high = 0.35 * omega[0], 3.0 * omega[-1]

    def left(x: NDArray) -> NDArray:
        mode = np.concatenate([[low], 2 * np.pi * poles[:, 0] * np.exp(x[:n]), [high]])
        zeta = np.concatenate([[0.05], poles[:, 1] * np.exp(x[n:]), [0.05]])
        r = (h - _residues(omega, h, weight, mode, zeta).T @ _basis(omega, mode, zeta)) * weight
        return np.concatenate([r.real.ravel(), r.imag.ravel()])

    reach = np.concatenate([np.full(n, 0.02), np.full(n, 2.0)])
    found = least_squares(left, np.zeros(2 * n), bounds=(-reach, reach), x_scale=reach, max_nfev=60).x
    return poles[:, 0] * np.exp(found[:n]), poles[:, 1] * np.exp(found[n:])
