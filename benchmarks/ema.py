"""Modal identification beside sdypy-EMA: poles, damping ratios, residues and synthesised FRFs in one run.

    python benchmarks/ema.py --draws 5
    python benchmarks/ema.py --draws 0 --recordings DIR

sdypy-EMA (`pip install -e ".[ema]"`) fits a common denominator (LSCF) and modal constants (LSFD), with complex or with
real modes and with a complex inertia and a complex stiffness for the rest. Its poles are picked as an operator would
who knows the modes: at each order the decaying pole nearest to each true frequency, and of all orders those whose
reconstruction misses least of the measured FRFs. labnnum is told nothing but the FRFs: `identify` (real modes, what
`labnnum identify` writes) and `fit_residues` from its poles; the latter also with the noise stated, as the estimators
of labnnum do and sdypy-EMA cannot use.

Simulated: five responses of random modes, exactly known; what is printed is the median over the draws of relative RMS
errors of frequencies, damping ratios and residues, and of the FRFs against those without noise; a mode that is not
found counts as an error of 1. Recordings (`--recordings`, see examples/recordings/README.md): what the fit to all lines
misses of them, and what a fit to every second line misses of those between; sdypy-EMA's poles are picked near those
that labnnum found, as no truth is known.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from labnnum.errors import EstimationError
from labnnum.frf import MOTION_ORDER, Frf
from labnnum.identification import identify, reciprocal
from labnnum.identification_residues import PoleResidues, fit_residues
from labnnum.recording import Channel

HIGHEST = 50
"""Orders of sdypy-EMA that are picked from; labnnum's diagram goes to 40 (real data: the same option)."""
FORMS = {0: "receptance", 1: "mobility", 2: "accelerance"}
SENSORS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in range(5))
FORCE = (Channel("f", "force", "reference", "0", "x"),)


@dataclass(frozen=True, eq=False)
class Answer:
    """Frequencies (n,) in Hz, damping ratios (n,), residues (n, n_out) of receptances, FRFs (n_out, n_f), seconds."""

    frequency: NDArray[np.float64]
    damping: NDArray[np.float64]
    residue: NDArray[np.complex128]
    fitted: NDArray[np.complex128]
    seconds: float


# -------------------------------------------------------------------- sdypy-EMA


def peer(frf: Frf, near: NDArray, real: bool) -> Answer:
    """The answer of sdypy-EMA, its poles picked near frequencies (n,) in Hz.

    Its lines must begin at a multiple of their spacing, and it drops the line at its upper limit: one is put above.
    """
    from sdypy.EMA import Model

    begun = time.process_time()
    f, value = frf.frequency, frf.value[:, 0]
    step = f[1] - f[0]
    lines, rows = np.append(f, f[-1] + step), np.column_stack([value, value[:, -1]])
    sign = np.array([c.sign for c in frf.outputs]) * frf.inputs[0].sign
    form = FORMS[MOTION_ORDER[frf.outputs[0].quantity]]
    best, least = None, np.inf
    with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        m = Model(rows, lines, lower=float(f[0]), upper=float(lines[-1]), pol_order_high=HIGHEST, frf_form=form)
        m.get_poles(show_progress=False)
        for at, poles in enumerate(m.all_poles):
            picked = pick(np.asarray(poles), near)
            if picked is None:
                continue
            m.pole_ind = np.array([[at, i] for i in picked])
            made, constants = m.get_constants(method="lsfd_proportional" if real else "lsfd", f_upper=float(f[-1]))
            made = made[:, np.argmin(np.abs(m.freq - f[0])) :][:, : f.size]
            missed = np.linalg.norm(made - value)
            if missed < least:
                p = np.asarray(poles)[picked]
                residue = constants.T / (2j * p.imag[:, None]) if real else constants.T
                best, least = (p, residue * sign, made), missed
    if best is None:
        raise EstimationError("sdypy-EMA has no order with a pole for each mode")
    p, residue, made = best
    return Answer(np.abs(p) / 2 / np.pi, -p.real / np.abs(p), residue, made, time.process_time() - begun)


def pick(poles: NDArray, near: NDArray) -> list[int] | None:
    """Numbers of the decaying poles nearest to each frequency in Hz, each taken once; None where there are too few."""
    size = np.abs(poles)
    good = np.isfinite(size) & (poles.imag > 0) & (poles.real < 0) & (-poles.real < 0.3 * size)
    out: list[int] = []
    for f in near:
        left = [i for i in np.flatnonzero(good) if i not in out]
        if not left:
            return None
        out.append(min(left, key=lambda i: abs(size[i] / 2 / np.pi - f)))
    return out


# -------------------------------------------------------------------- labnnum


def ours(frf: Frf, order: int = 40) -> tuple[Answer, Answer]:
    """Real modes as `labnnum identify` writes them, and complex residues from the same poles."""
    begun = time.process_time()
    found = identify(frf, order)
    seconds = time.process_time() - begun
    order_of = np.array([MOTION_ORDER[c.quantity] for c in frf.outputs])[:, None]
    sign = np.array([c.sign for c in frf.outputs])[:, None] * frf.inputs[0].sign
    shapes, omega = found.shapes, 2 * np.pi * found.frequency
    drive = [c.dof for c in frf.outputs].index(frf.inputs[0].dof)
    damped = omega * np.sqrt(1 - found.damping_ratio**2)
    residue = (shapes * shapes[drive]).T / (2j * damped[:, None])
    real = Answer(found.frequency, found.damping_ratio, residue, found.fitted * sign * (1j * frf.omega) ** order_of,
                  seconds)  # fmt: skip
    free = fit_residues(frf, np.column_stack([found.frequency, found.damping_ratio]))
    return real, free_answer(free, time.process_time() - begun)


def free_answer(free: PoleResidues, seconds: float) -> Answer:
    """The same of complex residues."""
    return Answer(free.frequency, free.damping_ratio, free.residue, free.fitted, seconds)


# -------------------------------------------------------------------- simulated structures


@dataclass(frozen=True, eq=False)
class Truth:
    """Modes in the band and the FRFs of all modes, (n_out, n_f) on lines in Hz."""

    frequency: NDArray[np.float64]
    damping: NDArray[np.float64]
    residue: NDArray[np.complex128]
    lines: NDArray[np.float64]
    value: NDArray[np.complex128]


def apart(rng: Generator, low: float, high: float, n: int, gap: float) -> NDArray[np.float64]:
    """n frequencies between two in Hz, at least a gap apart."""
    while True:
        f = np.sort(rng.uniform(low, high, n))
        if n < 2 or np.diff(f).min() > gap:
            return f


def lines_of(low: float, high: float, each: int) -> NDArray[np.float64]:
    return np.arange(round(low * each), round(high * each) + 1) / each


def well_apart(rng: Generator) -> Truth:
    return truth(rng, apart(rng, 10, 65, 4, 3.0), rng.uniform(0.005, 0.02, 4), lines_of(5, 70, 16))


def close(rng: Generator) -> Truth:
    """Two of four modes 0.3 to 0.75 half-power bandwidths apart."""
    usual, f = rng.uniform(0.003, 0.008), rng.uniform(25, 45)
    other = f * (1 + rng.uniform(0.6, 1.5) * usual)
    every = np.array([rng.uniform(10, 18), f, other, rng.uniform(52, 65)])
    return truth(rng, every, usual * rng.uniform(0.8, 1.25, 4), lines_of(5, 70, 16))


def light(rng: Generator) -> Truth:
    return truth(rng, apart(rng, 10, 65, 4, 3.0), rng.uniform(2e-4, 6e-4, 4), lines_of(5, 70, 64))


def heavy(rng: Generator) -> Truth:
    return truth(rng, apart(rng, 10, 65, 5, 5.0), rng.uniform(0.02, 0.06, 5), lines_of(5, 70, 8))


def cut(rng: Generator) -> Truth:
    """Three modes in the band, two below and two above it with larger shapes."""
    every = np.concatenate([apart(rng, 3, 9, 2, 1.0), apart(rng, 22, 58, 3, 4.0), apart(rng, 75, 110, 2, 5.0)])
    size = np.array([2.0, 2.0, 1.0, 1.0, 1.0, 2.0, 2.0])
    return truth(rng, every, rng.uniform(0.005, 0.02, 7), lines_of(16, 64, 16), size)


def truth(rng: Generator, f: NDArray, zeta: NDArray, lines: NDArray, size: NDArray | None = None) -> Truth:
    """Random shapes at five places, the first of which is driven and moves in every mode."""
    shape = rng.standard_normal((f.size, 5))
    shape[:, 0] = np.where(shape[:, 0] < 0, -1, 1) * np.maximum(np.abs(shape[:, 0]), 0.4)
    shape *= 1.0 if size is None else size[:, None]
    w, s = 2 * np.pi * f, 2j * np.pi * lines
    product = shape * shape[:, :1]
    value = s**2 * (product.T @ (1 / (s**2 + 2 * (zeta * w)[:, None] * s + (w**2)[:, None])))
    inside = (f > lines[0]) & (f < lines[-1])
    residue = product / (2j * w * np.sqrt(1 - zeta**2))[:, None]
    return Truth(f[inside], zeta[inside], residue[inside], lines, value)


FAMILIES = {
    "well apart": well_apart, "close": close, "light": light, "heavy": heavy, "cut band": cut,
}  # fmt: skip
NOISE = (("even", 0.001), ("even", 0.01), ("relative", 0.02))
"""Of the RMS of a response on all lines alike, or of the response on each line."""
WAYS = ("sdypy, real", "ours, real", "sdypy", "ours", "ours, noise stated")
BESIDE = {"ours, real": "sdypy, real", "ours": "sdypy", "ours, noise stated": "sdypy"}


def noisy(t: Truth, kind: str, share: float, rng: Generator) -> Frf:
    size = np.abs(t.value)
    if kind == "even":
        size = np.sqrt(np.mean(size**2, axis=1, keepdims=True)) * np.ones(size.shape)
    normal = rng.standard_normal((2, *size.shape)) / np.sqrt(2)
    value = t.value + share * size * (normal[0] + 1j * normal[1])
    return Frf(t.lines, value[:, None], SENSORS, FORCE, variance=((share * size) ** 2)[:, None])


def errors(t: Truth, a: Answer) -> NDArray[np.float64]:
    """Relative RMS errors of frequencies, damping ratios and residues, and of the FRFs; 1 for each mode not found."""
    rows, taken = [], set()
    for f, z, r in zip(t.frequency, t.damping, t.residue, strict=True):
        left = [i for i in range(a.frequency.size) if i not in taken]
        i = min(left, key=lambda i: abs(a.frequency[i] - f), default=None)
        if i is None or abs(a.frequency[i] - f) > max(4 * z, 2e-3) * f:
            rows.append((1.0, 1.0, 1.0))
            continue
        taken.add(i)
        off = np.linalg.norm(a.residue[i] - r) / np.linalg.norm(r)
        rows.append((abs(a.frequency[i] / f - 1), min(abs(a.damping[i] / z - 1), 1.0), min(off, 1.0)))
    made = np.linalg.norm(a.fitted - t.value, axis=1) / np.linalg.norm(t.value, axis=1)
    return np.array([*np.sqrt(np.mean(np.square(rows), axis=0)), np.sqrt(np.mean(made**2))])


def simulated(draws: int, seed: int) -> None:
    """A table a family and kind of noise."""
    print(
        f"simulated, {draws} draws, seed {seed}: medians of relative errors; in brackets how often sdypy is not better"
    )
    print(f"{'':34s}{'frequency':>16s}{'damping':>16s}{'residues':>16s}{'FRFs':>16s}   cpu s")
    count = dict.fromkeys(BESIDE, 0)
    for at, (family, drawn) in enumerate(FAMILIES.items()):
        for number, (kind, share) in enumerate(NOISE):
            found: dict[str, list[NDArray]] = {way: [] for way in WAYS}
            seconds: dict[str, list[float]] = {way: [] for way in WAYS}
            for i in range(draws):
                rng = default_rng([seed, at, number, i])
                t = drawn(rng)
                frf = noisy(t, kind, share, rng)
                for way, answer in answers(t, frf).items():
                    found[way].append(np.ones(4) if answer is None else errors(t, answer))
                    seconds[way].append(np.nan if answer is None else answer.seconds)
            print(f"{family}, noise {kind} {100 * share:g} %", flush=True)
            for way in WAYS:
                mine = np.array(found[way])
                shown = [f"{x:10.2e}" for x in np.median(mine, axis=0)]
                if way in BESIDE:
                    better = np.sum(mine <= np.array(found[BESIDE[way]]), axis=0)
                    shown = [f"{s} ({b}/{draws})" for s, b in zip(shown, better, strict=True)]
                    count[way] += int(better.sum())
                print(f"    {way:30s}" + "".join(f"{s:>16s}" for s in shown) + f"{np.nanmean(seconds[way]):8.2f}",
                      flush=True)  # fmt: skip
    total = 4 * draws * len(FAMILIES) * len(NOISE)
    print("not worse than sdypy: " + ", ".join(f"{way} {n} of {total}" for way, n in count.items()))


def answers(t: Truth, frf: Frf) -> dict[str, Answer | None]:
    """Each way's answer, None where it fails."""
    out: dict[str, Answer | None] = dict.fromkeys(WAYS)
    for way, real in (("sdypy, real", True), ("sdypy", False)):
        with contextlib.suppress(EstimationError, np.linalg.LinAlgError):
            out[way] = peer(frf, t.frequency, real)
    with contextlib.suppress(EstimationError):
        out["ours, real"], out["ours"] = ours(replace(frf, variance=None))
    with contextlib.suppress(EstimationError):
        out["ours, noise stated"] = ours(frf)[1]
    return out


# -------------------------------------------------------------------- recordings


SETS = {
    "F-16, level 1": ("f16", "F16Data_FullMSine_Level1.mat", "channels.toml", (2.5, 14.0), 1, 40),
    "Silverbox, quiet start": ("silverbox", "SNLS80mV.mat", "start.channels.toml", (5.0, 200.0), 1, 40),
    "milling tool": ("milling_tool", "FRF_Point_*.txt", "frf.channels.toml", (600.0, 3200.0), 1, 40),
    "free-free beam": ("freefree_beam", "frf_9pts.npz", "channels.toml", (90.0, 650.0), 2, 24),
}
"""Folder, files, channels.toml, band in Hz, every how many lines are taken, highest order."""


def recorded(recordings: Path, examples: Path) -> None:
    """A table of the recordings that are there."""
    print("recordings: relative RMS errors of the FRFs, fitted to all lines; fitted to every second, on those between")
    for name, (folder, files, channels, band, every, order) in SETS.items():
        paths = sorted((recordings / folder).glob(files))
        if not paths:
            print(f"{name}: not there")
            continue
        frf = read(paths, examples / folder / channels)
        step = frf.frequency[1] - frf.frequency[0]
        number = np.round(frf.frequency / step).astype(int)
        inside = (frf.frequency >= band[0]) & (frf.frequency <= band[1])
        whole = frf.at(inside & (number % every == 0))
        half, between = (frf.at(inside & (number % (2 * every) == k * every)) for k in (0, 1))
        show(name, whole, half, between, order)


def read(paths: list[Path], channels: Path) -> Frf:
    """The FRFs that files hold; those of several hammers and one sensor turned round."""
    from sessions.exchange import read_files
    from sessions.identify import lowest

    found = read_files(paths, channels)
    frf = found if isinstance(found, Frf) else lowest(paths, channels).frf
    return reciprocal(frf) if len(frf.outputs) == 1 and len(frf.inputs) > 1 else frf


def show(name: str, whole: Frf, half: Frf, between: Frf, order: int) -> None:
    """Rows of one recording; poles of sdypy-EMA are picked near those that labnnum found."""
    begun = time.process_time()
    every, part = (complex_residues(frf, order) for frf in (whole, half))
    print(f"{name}: {whole.frequency.size} lines, {len(every.frequency)} modes, {time.process_time() - begun:.1f} s")
    rows = {"ours": (every, part)}
    for way, real in (("sdypy", False), ("sdypy, real", True)):
        with contextlib.suppress(EstimationError, np.linalg.LinAlgError):
            rows[way] = (peer(whole, every.frequency, real), peer(half, part.frequency, real))
    for way, (a, b) in rows.items():
        on, off = rms(missed(a.fitted, whole)), rms(missed(carried(b, half, between), between))
        poles = ", ".join(f"{f:.5g} Hz {100 * z:.3g} %" for f, z in zip(a.frequency, a.damping, strict=True))
        print(f"    {way:12s} {on:9.5f} {off:9.5f}   {poles}", flush=True)


def complex_residues(frf: Frf, order: int) -> Answer:
    """What labnnum makes of FRFs that it is given with their noise, where that is known."""
    found = identify(frf, order)
    return free_answer(fit_residues(frf, np.column_stack([found.frequency, found.damping_ratio])), 0.0)


def rms(x: NDArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def carried(a: Answer, fitted: Frf, between: Frf) -> NDArray[np.complex128]:
    """FRFs on other lines: the modes there, and what else was fitted, which is smooth, interpolated."""

    def modes(frf: Frf) -> NDArray:
        s = 1j * frf.omega
        p = 2 * np.pi * a.frequency * (-a.damping + 1j * np.sqrt(1 - a.damping**2))
        order = np.array([MOTION_ORDER[c.quantity] for c in frf.outputs])[:, None]
        sign = np.array([c.sign for c in frf.outputs])[:, None] * frf.inputs[0].sign
        both = a.residue.T @ (1 / (s - p[:, None])) + a.residue.T.conj() @ (1 / (s - p.conj()[:, None]))
        return sign * s**order * both

    smooth = a.fitted - modes(fitted)
    rest = [CubicSpline(fitted.frequency, row)(between.frequency) for row in smooth]
    return modes(between) + np.array(rest)


def missed(made: NDArray, frf: Frf) -> NDArray[np.float64]:
    """Relative errors of FRFs (n_out,)."""
    measured = frf.value[:, 0]
    return np.linalg.norm(made - measured, axis=1) / np.linalg.norm(measured, axis=1)


def main() -> None:
    """Both parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recordings", type=Path)
    parser.add_argument("--examples", type=Path, default=Path(__file__).parents[1] / "examples" / "recordings")
    a = parser.parse_args()
    try:
        import matplotlib

        matplotlib.use("Agg")
        import sdypy.EMA  # noqa: F401
    except ImportError as error:
        raise SystemExit(f"{error.name} is not installed: pip install -e '.[ema]'") from None
    if a.draws:
        simulated(a.draws, a.seed)
    if a.recordings:
        recorded(a.recordings, a.examples)


if __name__ == "__main__":
    main()
