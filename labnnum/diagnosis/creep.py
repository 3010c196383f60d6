"""A structure whose stiffness creeps during the session: seen, followed, and taken back to one moment.

Where all stiffness grows by a factor exp(2 d), natural frequencies grow by exp(d), and a transfer function from force
to acceleration becomes H(s exp(-d)): it is stretched along the frequency axis, whatever else the structure may hold.
Every period of a multisine and every hit is a piece of its own; its stretch against the whole session is found by least
squares, from piece to piece, and taken back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from labnnum.diagnosis.observe import Observation, hit_spectra, smooth, steady_periods
from labnnum.frf import Frf

Points = NDArray[np.complexfloating]

HALF = 6
"""Lines on either side of one that its local rational function is fitted to."""
ROUNDS = 3
"""Times that the session's mean is formed from pieces that were taken back."""
CHANCE = 1e-4
"""Probability that a trend of sound pieces passes for a creep."""
LIKELY = 0.01
"""And for one that is worth following: a mean over a creep is smeared, and pieces are told by it roughly."""
BESIDE = 10.0
"""Change from run to run, over what the trend within runs leads to, above which something else than time acts."""
SPAN = 0.06
"""Stretch within which runs held out are looked for."""
LEAST = 2e-4
"""Change of the frequencies over the session below which a creep is not spoken of: any room does that."""
ROUGH = 2e-3
"""Error of the local functions, relative; keeps lines with little noise from outweighing all others."""
ORDERS = {"displacement": 0, "velocity": 1, "acceleration": 2, "angle": 0, "angular_velocity": 1}
"""Derivatives of the motion that a quantity holds, 2 if not listed; of a force, what a stretch leaves as large."""


@dataclass(frozen=True, eq=False)
class Creep:
    """Stretch of every piece of a session.

    Parameters
    ----------
    change : float
        Change of the natural frequencies from the session's beginning to its end, relative.
    std : float
        Its standard deviation.
    time : ndarray, shape (n_pieces,)
        Middle of every piece, 0 at the beginning of what was recorded and 1 at its end.
    stretch : ndarray, shape (n_pieces,)
        Logarithm of its frequencies over those of the whole session.
    """

    change: float
    std: float
    time: NDArray[np.float64]
    stretch: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Piece:
    """One period or hit on the lines of its observation: number of that observation, time, input (n_f,) and outputs
    (n_out, n_f), variance of the FRF (n_out, n_f).
    """

    owner: int
    time: float
    u: NDArray[np.complex128]
    y: NDArray[np.complex128]
    variance: NDArray[np.float64]

    @property
    def value(self) -> NDArray[np.complex128]:
        return self.y / self.u


class Local:
    """Local rational functions through scattered values of FRFs, one denominator for all outputs.

    Of degree two over two around every centre (McKelvey and Guerin, 2012); between the centres, and beside the axis,
    the function of the nearest centre holds.

    Parameters
    ----------
    centres : ndarray, shape (n,)
        Points of the complex plane by increasing imaginary part.
    s : ndarray, shape (n_points,)
        Where the values are, likewise.
    value : ndarray, shape (n_out, n_points)
    weight : ndarray, shape (n_points,)
        Inverse standard deviations, relative.
    each : int
        Values at about each centre.
    """

    def __init__(self, centres: Points, s: Points, value: Points, weight: NDArray, each: int) -> None:
        n = min((2 * HALF + 1) * each, s.size)
        self.centres = centres
        first = np.clip(np.searchsorted(s.imag, centres.imag) - n // 2, 0, s.size - n)
        around = first[:, None] + np.arange(n)
        self.scale = np.max(np.abs(s[around] - centres[:, None]), axis=1)
        r = (s[around] - centres[:, None]) / self.scale[:, None]
        w = weight[around]
        powers = r[:, :, None] ** np.arange(3)
        q, upper = np.linalg.qr(w[:, :, None] * powers)
        normal = np.zeros((centres.size, 2, 2), complex)
        right = np.zeros((centres.size, 2), complex)
        for row in value:
            h = row[around]
            size = np.sqrt(np.mean(np.abs(w * h) ** 2, axis=1))[:, None] + 1e-300
            known = w * h / size
            columns = -known[:, :, None] * powers[:, :, 1:]
            # the numerators are projected out, so that only the two coefficients of the denominator are solved for
            columns = columns - q @ (np.conj(q.transpose(0, 2, 1)) @ columns)
            known = known - np.einsum("kji,ki->kj", q, np.einsum("kji,kj->ki", np.conj(q), known))
            normal += np.einsum("kjc,kjd->kcd", np.conj(columns), columns)
            right += np.einsum("kjc,kj->kc", np.conj(columns), known)
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-300 * np.eye(2)
        a = np.linalg.solve(normal, right[..., None])[..., 0]
        self.a = np.concatenate([np.ones((a.shape[0], 1)), a], axis=1)
        through = w * np.einsum("kjp,kp->kj", powers, self.a)
        inside = np.einsum("kji,okj->oki", np.conj(q), through * value[:, around])
        self.b = np.linalg.solve(upper[None], inside[..., None])[..., 0]

    def __call__(self, at: Points) -> NDArray[np.complex128]:
        """Values (n_out, n) at points `at` (n,)."""
        middle = (self.centres.imag[1:] + self.centres.imag[:-1]) / 2
        near = np.searchsorted(middle, at.imag)
        r = (at - self.centres[near]) / self.scale[near]
        powers = r[:, None] ** np.arange(3)
        return np.einsum("oki,ki->ok", self.b[:, near], powers) / np.einsum("ki,ki->k", self.a[near], powers)


def take_back(
    observations: Sequence[Observation], held_out: Sequence[Observation] = ()
) -> tuple[Creep | None, list[Observation], list[Observation]]:
    """The creep of a session, None where there is none, and its observations as of the session's middle.

    Parameters
    ----------
    observations : sequence of Observation
        In any order; each knows which of the session's recordings it holds.
    held_out : sequence of Observation
        Of the same structure at moments that are not known: stretched back likewise, and not asked whether it creeps.

    Returns
    -------
    creep : Creep or None
    observations, held_out : list of Observation
        The same where nothing creeps. Else with FRFs whose pieces were stretched back before the mean was taken;
        their variance is that of what then remains. What has no pieces (noise, FRFs) stays as it is.
    """
    same = None, list(observations), list(held_out)
    pieces = _pieces(observations)
    if len(pieces) < 4:
        return same
    frfs = [o.frf for o in observations]
    zero = np.zeros(len(pieces))
    first = _Stretch(pieces, zero, frfs)
    rough = np.array([first.step(p, frfs[p.owner], 0.0)[0] for p in pieces])
    if _trend(pieces, rough, observations, LIKELY) is None:
        return same
    middle = _middle(pieces, observations)
    made, stretch, plain = _Stretch([pieces[i] for i in middle], zero[middle], frfs), zero, pieces
    for i in range(ROUNDS):
        stretch = _follow(made, plain, frfs, middle[0], wide=i == 0)
        stretch -= np.mean(stretch)
        made = _Stretch(plain, stretch, frfs)
        plain = _unleaked(pieces, stretch, made, observations)
    out = _means(plain, stretch, made, observations)
    creep = _trend(pieces, stretch, observations, CHANCE)
    if creep is None:
        return same
    later = _pieces(held_out)
    if later and _names(held_out[later[0].owner].frf) == _names(frfs[pieces[0].owner]):
        own = [o.frf for o in held_out]
        moved = _follow(made, later, own, 0, wide=True)
        return creep, out, _means(_unleaked(later, moved, made, held_out), moved, made, held_out)
    return creep, out, same[2]


def _pieces(observations: Sequence[Observation]) -> list[_Piece]:
    """All periods and hits, in the order in which they were made."""
    start = _starts(observations)
    if not start:
        return []
    out = []
    for number, o in enumerate(observations):
        if o.kind == "periodic":
            out += _periods(number, o, start[o.order[0]])
        elif o.kind == "hammer":
            out += _hits(number, o, [start[i] for i in o.order])
    first = [observations[p.owner].frf for p in out]
    if any(_names(f) != _names(first[0]) or f.settings.get("window_decay") != first[0].settings.get("window_decay")
           for f in first):  # fmt: skip
        return []
    return sorted(out, key=lambda p: p.time)


def _names(frf: Frf) -> list[str]:
    return [c.name for c in (*frf.inputs, *frf.outputs)]


def _starts(observations: Sequence[Observation]) -> dict[int, float]:
    """Number of each recording -> seconds of record before it; empty where that is not known."""
    if any(len(o.order) != len(o.recordings) or not o.order for o in observations):
        return {}
    length = {i: r.data.shape[1] / r.rate for o in observations for i, r in zip(o.order, o.recordings, strict=True)}
    before, out = 0.0, {}
    for i in sorted(length):
        out[i] = before
        before += length[i]
    return out


def _periods(number: int, o: Observation, start: float) -> list[_Piece]:
    recording = o.recordings[0]
    x = steady_periods(recording)
    n = recording.period
    lines = np.round(o.frf.frequency * n / recording.rate).astype(int)
    spectra = np.fft.rfft(x, axis=2)[:, :, lines] * (2 / n)
    last = start + recording.data.shape[1] / recording.rate
    times = last - (len(x) - 0.5 - np.arange(len(x))) * n / recording.rate
    return _made(number, o, times, spectra[:, recording.inputs[0]], spectra[:, list(recording.outputs)])


def _hits(number: int, o: Observation, starts: Sequence[float]) -> list[_Piece]:
    recording = o.recordings[0]
    x, spectra, _ = hit_spectra(o.recordings)
    spans = [(at, r.rate, span) for at, r in zip(starts, o.recordings, strict=True) for span in r.spans()]
    times = np.array([at + (a + b) / 2 / rate for at, rate, (a, b) in spans])
    lines = np.round(o.frf.frequency * x.shape[2] / recording.rate).astype(int)
    spectra = spectra[:, :, lines]
    return _made(number, o, times, spectra[:, recording.inputs[0]], spectra[:, list(recording.outputs)])


def _made(number: int, o: Observation, times: NDArray, u: NDArray, y: NDArray) -> list[_Piece]:
    """Pieces of one observation; their noise from the steps between neighbours in time."""
    if len(times) < 2 or y.shape[1] != len(o.frf.outputs):
        return []
    order = np.argsort(times)
    h = y[order] / u[order][:, None]
    w = np.abs(u[order]) ** 2
    share = 1 / (1 / w[1:] + 1 / w[:-1])  # the step's variance is noise (1/w + 1/w'): this is its inverse
    noise = smooth(np.mean(np.abs(np.diff(h, axis=0)) ** 2 * share[:, None], axis=0), 9)
    return [
        _Piece(number, float(t), a, b, noise / np.maximum(np.abs(a) ** 2, 1e-300))
        for t, a, b in zip(times, u, y, strict=True)
    ]


class _Stretch:
    """What pieces taken back say together, as a function that can be stretched."""

    def __init__(self, pieces: Sequence[_Piece], stretch: NDArray[Any], frfs: Sequence[Frf]) -> None:
        used = [frfs[p.owner] for p in pieces]
        self.decay = float(used[0].settings.get("window_decay", 0.0))
        order = np.array([ORDERS.get(c.quantity, 2) for c in used[0].outputs])
        self.power = order - ORDERS.get(used[0].inputs[0].quantity, 2)
        lines = np.unique(np.concatenate([f.omega for f in used]).round(6))
        omega = np.concatenate([f.omega * np.exp(-d) for f, d in zip(used, stretch, strict=True)])
        decay = np.concatenate(
            [np.full(f.omega.size, self.decay) * np.exp(-d) for f, d in zip(used, stretch, strict=True)]
        )
        back = np.exp(-self.power[:, None] * stretch)
        value = np.concatenate([p.value * b[:, None] for p, b in zip(pieces, back.T, strict=True)], axis=1)
        sizes = np.sqrt(np.mean([np.mean(np.abs(p.value) ** 2, axis=1) for p in pieces], axis=0)) + 1e-300
        noise = np.concatenate([np.mean(p.variance / sizes[:, None] ** 2, axis=0) for p in pieces])
        rough = np.concatenate([np.mean(np.abs(p.value / sizes[:, None]) ** 2, axis=0) for p in pieces])
        at = np.argsort(omega)
        weight = 1 / np.sqrt(noise + ROUGH**2 * rough + 1e-300)
        each = max(round(omega.size / lines.size), 1)
        self.local = Local(self.decay + 1j * lines, (decay + 1j * omega)[at], value[:, at], weight[at], each)

    def __call__(self, frf: Frf, d: float) -> NDArray[np.complex128]:
        """FRFs (n_out, n_f) on the lines of `frf` with all frequencies higher by exp(d)."""
        s = (self.decay + 1j * frf.omega) * np.exp(-d)
        return self.local(s) * np.exp(d * self.power)[:, None]

    def step(self, piece: _Piece, frf: Frf, d: float, eps: float = 1e-5) -> tuple[float, float]:
        """Gauss-Newton step of a piece's stretch from `d`, and chi-square there."""
        here = self(frf, d)
        slope = (self(frf, d + eps) - self(frf, d - eps)) / (2 * eps)
        weight = 1 / (piece.variance + (ROUGH * np.abs(here)) ** 2 + 1e-300)
        left = piece.value - here
        down = float(np.sum(weight * np.abs(slope) ** 2))
        return float(np.sum(weight * np.real(np.conj(slope) * left)) / max(down, 1e-300)), float(
            np.sum(weight * np.abs(left) ** 2)
        )

    def found(self, piece: _Piece, frf: Frf, start: float) -> float:
        """The stretch of a piece, by steps that lower chi-square, from `start`."""
        d = start
        move, now = self.step(piece, frf, d)
        for _ in range(12):
            while abs(move) > 1e-8:
                ahead, there = self.step(piece, frf, d + move)
                if there < now:
                    break
                move /= 4
            else:
                return d
            d, move, now = d + move, ahead, there
        return d


def _middle(pieces: Sequence[_Piece], observations: Sequence[Observation]) -> list[int]:
    """Numbers of the hit nearest the session's middle, or of two to four periods of a run there."""
    times = np.array([p.time for p in pieces])
    centre = int(np.argmin(np.abs(times - (times[0] + times[-1]) / 2)))
    owner = pieces[centre].owner
    own = [i for i, p in enumerate(pieces) if p.owner == owner]
    own.sort(key=lambda i: abs(times[i] - times[centre]))
    return own[:1] if observations[owner].kind == "hammer" else own[: min(4, max(2, len(own) // 2))]


def _follow(
    made: _Stretch, pieces: Sequence[_Piece], frfs: Sequence[Frf], centre: int, wide: bool = False
) -> NDArray[np.float64]:
    """Stretch of every piece against `made`: from the piece `centre` outwards, each from where its neighbours lead;
    where nothing is known yet (`wide`), from the best of many around.
    """
    n = len(pieces)
    out = np.full(n, np.nan)
    for way in (range(centre, n), range(centre - 1, -1, -1)):
        for i in way:
            back = 1 if way.step < 0 else -1
            near = [out[j] for j in (i + back, i + 2 * back) if 0 <= j < n and np.isfinite(out[j])]
            guess = 0.0 if not near else near[0] + (near[0] - near[1] if len(near) > 1 else 0.0)
            frf, piece = frfs[pieces[i].owner], pieces[i]
            if wide:
                around = guess + np.linspace(-1, 1, 41) * (SPAN if len(near) < 2 else SPAN / 3)
                guess = min([guess, *around], key=lambda d: made.step(piece, frf, float(d))[1])
            out[i] = made.found(piece, frf, float(guess))
    return out


def _means(
    pieces: Sequence[_Piece], stretch: NDArray, made: _Stretch, observations: Sequence[Observation]
) -> list[Observation]:
    """Observations whose pieces were taken back."""
    out = list(observations)
    for number, o in enumerate(observations):
        mine = [i for i, p in enumerate(pieces) if p.owner == number]
        if not mine:
            continue
        still = made(o.frf, 0.0)
        u = np.array([pieces[i].u for i in mine])
        y = np.array([pieces[i].y + pieces[i].u * (still - made(o.frf, stretch[i])) for i in mine])
        power = np.sum(np.abs(u) ** 2, axis=0)
        h = np.sum(y * np.conj(u)[:, None], axis=0) / power
        left = np.sum(np.abs(y - h * u[:, None]) ** 2, axis=0) / max(len(mine) - 1, 1) / power
        variance = smooth(left, 9) if o.kind == "hammer" else 0.5 * left + 0.5 * smooth(left, 9)
        out[number] = replace(o, frf=replace(o.frf, value=h[:, None], variance=variance[:, None]))
    return out


def _unleaked(
    pieces: Sequence[_Piece], stretch: NDArray, made: _Stretch, observations: Sequence[Observation]
) -> list[_Piece]:
    """Periods without what a stretch that grows within them puts from every line onto the others; hits as they are.

    The response is that of the period's middle and a ramp of its change, and the spectrum of the two multiplied is not
    confined to lines that multiply.
    """
    times, out = np.array([p.time for p in pieces]), list(pieces)
    for number in {p.owner for p in pieces if observations[p.owner].kind == "periodic"}:
        o = observations[number]
        mine = [i for i, p in enumerate(pieces) if p.owner == number]
        n, rate = o.recordings[0].period, o.recordings[0].rate
        step = float(np.polynomial.Polynomial.fit(times[mine], stretch[mine], 1).convert().coef[1]) * n / rate
        lines = np.round(o.frf.frequency * n / rate).astype(int)
        ramp = (np.arange(n) + 0.5) / n - 0.5
        for i in mine:
            spectrum = np.zeros((len(o.frf.outputs), n // 2 + 1), complex)
            change = made(o.frf, stretch[i] + step / 2) - made(o.frf, stretch[i] - step / 2)
            spectrum[:, lines] = pieces[i].u * change
            leaked = np.fft.rfft(np.fft.irfft(spectrum, n, axis=1) * ramp, axis=1)[:, lines]
            out[i] = replace(pieces[i], y=pieces[i].y - leaked)
    return out


def _trend(
    pieces: Sequence[_Piece], stretch: NDArray, observations: Sequence[Observation], chance: float
) -> Creep | None:
    """Creep with time within the runs, where it is beyond `chance`; None else.

    Every run has a mean of its own, so that neither its level nor its realisation counts, and where hits differ in
    size their size may act as well (four or five hits are too few to tell).
    """
    time = np.array([p.time for p in pieces])
    time = (time - time[0]) / max(time[-1] - time[0], 1e-300)
    owner = np.array([p.owner for p in pieces])
    columns = [time, *[(owner == k).astype(float) for k in np.unique(owner)]]
    size = np.array([np.log(np.sqrt(np.mean(np.abs(p.u) ** 2)) + 1e-300) for p in pieces])
    if any(o.kind == "hammer" for o in observations) and len(time) > len(columns) + 3:
        columns.append(size)
    a = np.stack(columns, axis=1)
    free = len(time) - np.linalg.matrix_rank(a)
    if free < 2:
        return None
    inverse = np.linalg.pinv(a)
    x = inverse @ stretch
    left = stretch - a @ x
    std = float(np.sqrt(left @ left / free) * np.linalg.norm(inverse[0]))
    if abs(x[0]) < LEAST or 2 * stats.t.sf(abs(x[0]) / max(std, 1e-300), free) > chance:
        return None
    if np.ptp(stretch) > BESIDE * abs(x[0]):
        return None
    line = np.polynomial.Polynomial.fit(time, stretch, 1).convert().coef
    spread = float(np.std(stretch - line[0] - line[1] * time) / np.sqrt(len(time) * np.var(time)))
    return Creep(float(line[1]), spread, time, stretch - float(np.mean(stretch)))
