"""Calibration: sensitivities from a known tone or a known mass, and the delay and high-pass of inputs; with errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from labnnum.bands import Band
from labnnum.errors import EstimationError
from labnnum.frf import Frf

STANDARD_GRAVITY = 9.80665
"""m/s^2; CGPM (1901)."""
CALIBRATOR_HZ = 159.155
"""Frequency of handheld calibrators: 1000 rad/s, printed as 159.2 Hz."""
PIECES = 10
"""Stretches that a tone is cut into, to see how steady it is."""
PURE = 0.1
"""Share of the RMS that may be something else than the tone."""


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """A sensitivity as calibrated.

    Parameters
    ----------
    value : float
        Volts per SI unit, positive.
    error : float
        Standard error of `value`, from what was recorded; that of the calibrator comes on top.
    frequency : float
        Hz at which it holds: the tone's, or the middle of the band.
    impurity : float
        Share of the signal's RMS that the tone does not explain; for a mass, scatter of the lines over the mean.
    inverted : bool
        The channel has the opposite sign; only a mass can tell.
    """

    value: float
    error: float
    frequency: float
    impurity: float
    inverted: bool = False


def find_tone(signal: ArrayLike, rate: float, frequency: float, within: float = 0.03) -> float:
    """Frequency of the tone near `frequency`, in Hz, from how its phase goes on from one half to the other.

    Parameters
    ----------
    signal : array_like, shape (n,)
    rate : float
        Samples per second.
    frequency : float
        Expected, in Hz.
    within : float
        Share by which it may be off.

    Raises
    ------
    EstimationError
        The strongest line of the spectrum lies elsewhere: the message says where.

    Examples
    --------
    >>> t = np.arange(4000) / 4000
    >>> round(find_tone(0.1 * np.sin(2 * np.pi * 158.37 * t), 4000.0, 159.2), 4)
    158.37
    """
    x = np.asarray(signal, float)
    if x.size * frequency < 20 * rate:
        raise EstimationError(f"{x.size / rate:.3g} s hold fewer than 20 cycles of {frequency:g} Hz: record longer")
    shaped = (x - x.mean()) * np.hanning(x.size)
    size = np.abs(np.fft.rfft(shaped))
    line = rate / x.size
    strongest = int(np.argmax(size[2:]) + 2) * line
    if not size.max() > 0 or abs(strongest - frequency) > within * frequency + line:
        raise EstimationError(
            f"no tone at {frequency:g} Hz: the strongest line is at {strongest:.4g} Hz; is the calibrator on, and this"
            " the channel that it acts on?"
        )

    for _ in range(4):
        strongest += _detuned(x - x.mean(), strongest / rate) * rate
    return strongest


def _detuned(x: NDArray[np.float64], cycles: float) -> float:
    """How much a tone turns from one half of `x` to the other, in cycles per sample, against `cycles` per sample."""
    half = x.size // 2
    shaped = x[: 2 * half] * np.tile(np.hanning(half), 2) * np.exp(-2j * np.pi * cycles * np.arange(2 * half))
    return float(np.angle(shaped[half:].sum() * np.conj(shaped[:half].sum())) / (2 * np.pi * half))


def from_tone(volts: ArrayLike, rate: float, level: float, frequency: float = CALIBRATOR_HZ) -> Sensitivity:
    """Sensitivity from a recording of a known tone.

    Parameters
    ----------
    volts : array_like, shape (n,)
        The channel while the calibrator acts on it.
    rate : float
        Samples per second.
    level : float
        RMS of the tone in SI units: `STANDARD_GRAVITY` for a calibrator of 1 g RMS.
    frequency : float
        Hz; the tone is looked for around it.

    Raises
    ------
    EstimationError
        No such tone, one that is not steady, or one with a tenth of something else in it.

    Notes
    -----
    The tone's amplitude is fitted in ten stretches, together with a constant and two harmonics; the error is that of
    their mean.

    Examples
    --------
    >>> t = np.arange(20000) / 4000
    >>> s = from_tone(0.0102 * 9.80665 * np.sqrt(2) * np.sin(2 * np.pi * 159.2 * t), 4000.0, 9.80665)
    >>> round(s.value, 6), round(s.frequency, 3)
    (0.0102, 159.2)
    """
    x = np.asarray(volts, float)
    if not level > 0:
        raise EstimationError(f"the level of a tone must be positive, not {level:g}")
    exact = find_tone(x, rate, frequency)
    size, rest = np.array([_fit(piece, exact / rate) for piece in np.array_split(x, PIECES)]).T
    mean, error = float(size.mean()), float(size.std(ddof=1) / np.sqrt(PIECES))
    impurity = float(np.sqrt(np.mean(rest**2) / (np.mean(rest**2) + mean**2)))
    if np.ptp(size) > PURE * mean:
        raise EstimationError(
            f"the tone at {exact:.4g} Hz is not steady: its RMS goes from {size.min():.4g} to {size.max():.4g} V;"
            " hold still and record again"
        )
    if impurity > PURE:
        raise EstimationError(
            f"{impurity:.0%} of the signal's RMS is something else than the tone at {exact:.4g} Hz: is the contact"
            " firm, and nothing overloaded?"
        )
    return Sensitivity(mean / level, error / level, exact, impurity)


def _fit(x: NDArray[np.float64], cycles: float) -> tuple[float, float]:
    """RMS of a tone of `cycles` per sample, fitted with a constant and two harmonics, and RMS of all but these two."""
    turns = 2 * np.pi * cycles * np.arange(x.size)
    harmonics = [k for k in (1, 2, 3) if k * cycles < 0.45] or [1]
    basis = np.stack([np.ones(x.size), *(part(k * turns) for k in harmonics for part in (np.cos, np.sin))])
    fit = np.linalg.solve(basis @ basis.T, basis @ x)
    rest = x - fit[:3] @ basis[:3]
    return float(np.hypot(fit[1], fit[2]) / np.sqrt(2)), float(np.sqrt(np.mean(rest**2)))


def from_mass(frf: Frf, mass: float, sensitivity: float, band: Band) -> Sensitivity:
    r"""Sensitivity of a force channel from a free rigid mass whose acceleration is measured.

    Parameters
    ----------
    frf : Frf
        One acceleration (calibrated) over the force as `sensitivity` makes it of volts.
    mass : float
        kg, of all that moves beyond the force sensor, accelerometer and screws included.
    sensitivity : float
        V/N that the force was computed with.
    band : Band
        Hz in which the mass is rigid and its suspension soft.

    Raises
    ------
    EstimationError
        The band holds no line, or the FRF there is not that of a rigid mass.

    Notes
    -----
    Of the true force :math:`m a` the channel makes :math:`S m a` volts, and of these :math:`S m a / S_0` newtons, so
    :math:`S = S_0 / (m H)`. A delay between the channels is taken out first. Lines are weighted by their variance;
    where they scatter more than it says, the error is theirs. McConnell and Varoto (2008), section 4.10.
    """
    if frf.value.shape[:2] != (1, 1):
        raise EstimationError("a known mass needs the FRF of one acceleration over one force")
    part = frf.lines(band.low, band.high)
    if not part.frequency.size:
        raise EstimationError(f"the FRF has no line from {band.low:g} to {band.high:g} Hz")
    value = _in_step(part.frequency, np.asarray(part.value[0, 0]))
    variance = np.zeros(value.size) if part.variance is None else part.variance[0, 0] / 2
    spread = float(np.mean(np.abs(value - value.mean()) ** 2)) / 2
    weight = 1 / (variance + max(spread, 1e-24 * float(np.mean(np.abs(value) ** 2))))
    mean = complex(np.sum(weight * value) / weight.sum())
    error = 1 / np.sqrt(weight.sum())
    phase = np.degrees(np.angle(mean))
    turned = min(abs(phase), 180 - abs(phase))
    scatter = float(np.sqrt(spread) / abs(mean))
    if turned > 5 or scatter > PURE:
        raise EstimationError(
            f"from {band.low:g} to {band.high:g} Hz acceleration over force has a phase of {phase:.1f} degrees and"
            f" scatters by {scatter:.1%}: no rigid mass; choose a band above the suspension and below the first mode"
        )
    found = sensitivity / (mass * abs(mean.real))
    middle = float(np.sqrt(band.low * band.high)) if band.low > 0 else band.high / 2
    return Sensitivity(float(found), float(found * error / abs(mean)), middle, scatter, mean.real < 0)


def _in_step(frequency: NDArray, value: NDArray) -> NDArray[np.complex128]:
    """`value` without a phase that grows with frequency."""
    if frequency.size < 3:
        return value
    turned = value * np.sign(np.mean(np.real(value)) or 1.0)
    slope = float(frequency @ np.unwrap(np.angle(turned)) / (frequency @ frequency))
    return value * np.exp(-1j * slope * frequency)


@dataclass(frozen=True, slots=True)
class InputResponse:
    """What an input does to its signal besides its sensitivity: late by `delay`, and without what is slow.

    Parameters
    ----------
    delay : float
        s.
    highpass : float
        Corner of the AC coupling in Hz; 0 for none.
    gain : float
        Over that of the reference input.
    delay_error, highpass_error, gain_error : float
        Standard errors.
    """

    delay: float = 0.0
    highpass: float = 0.0
    gain: float = 1.0
    delay_error: float = 0.0
    highpass_error: float = 0.0
    gain_error: float = 0.0

    def at(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Complex factor of delay and high-pass on the signal, shape (n_f,); 0 at 0 Hz behind a high-pass.

        Examples
        --------
        >>> complex(np.round(InputResponse(highpass=2.0).at([2.0])[0], 3))
        (0.5+0.5j)
        """
        f = np.asarray(frequency, float)
        late = np.exp(-2j * np.pi * f * self.delay)
        return late * (1j * f / (1j * f + self.highpass)) if self.highpass else late


def from_common_signal(frf: Frf, reference_highpass: float = 0.0) -> dict[str, InputResponse]:
    r"""Delay, high-pass and gain of each input from one signal fed into all.

    Parameters
    ----------
    frf : Frf
        Of all inputs over the reference input, in volts.
    reference_highpass : float
        Corner of the reference input's own coupling in Hz; 0 if it is DC coupled.

    Returns
    -------
    dict of str to InputResponse
        By name of the channel: corners as they are, delays and gains over those of the reference, which stands among
        them with the corner given. `corrected` needs both sides of an FRF: its effect on the ratio was the quotient.

    Raises
    ------
    EstimationError
        Too few lines, or a ratio that delay and high-pass do not explain.

    Notes
    -----
    Fits :math:`g\, \frac{f}{f - i f_c} \big/ \frac{f}{f - i f_r} \; e^{-2\pi i f \tau}` by least squares, weighted by
    the variance of each line. Where the fit leaves more than the variance says, the errors are raised by as much.
    """
    f = frf.frequency
    used = f > 0
    if used.sum() < 8 or len(frf.inputs) != 1:
        raise EstimationError("a common signal needs one reference input and at least 8 lines")
    part, reference = frf.at(used), InputResponse(highpass=reference_highpass)
    fitted = {channel.name: _fitted(part, row, reference) for row, channel in enumerate(part.outputs)}
    return {frf.inputs[0].name: reference, **fitted}


def _fitted(frf: Frf, row: int, reference: InputResponse) -> InputResponse:
    f, value = frf.frequency, frf.value[row, 0] * reference.at(frf.frequency)
    variance = np.full(f.size, np.nan) if frf.variance is None else frf.variance[row, 0]
    known = np.isfinite(variance) & (variance > 0)
    sigma = np.sqrt(np.where(known, variance, np.nanmedian(variance) if known.any() else 1.0) / 2)
    slope = np.polyfit(f, np.unwrap(np.angle(value)), 1, w=1 / sigma)[0]
    scale = np.array([abs(value).mean(), 1 / f[-1], f[0]])

    def left(p: NDArray) -> NDArray[np.float64]:
        model = InputResponse(p[1] * scale[1], p[2] * scale[2])
        error = (p[0] * scale[0] * model.at(f) - value) / sigma
        return np.asarray(np.concatenate([error.real, error.imag]), float)

    start = [1.0, -slope / (2 * np.pi) / scale[1], 0.01]
    fit = least_squares(left, start, bounds=([0.0, -np.inf, 0.0], np.inf), x_scale="jac", xtol=1e-14, ftol=1e-14)
    excess = max(2 * fit.cost / (2 * f.size - 3), 1.0 if known.any() else 0.0)
    name = frf.outputs[row].name
    relative = np.sqrt(np.mean(np.abs(left(fit.x) ** 2)) * 2) * np.median(sigma) / abs(value).mean()
    if relative > PURE:
        raise EstimationError(
            f"channel {name!r}: a delay and a high-pass leave {relative:.0%} of the ratio to the reference unexplained;"
            " is the same signal on both inputs?"
        )
    error = np.sqrt(np.diag(np.linalg.pinv(fit.jac.T @ fit.jac)) * excess) * scale
    g, delay, corner = fit.x * scale
    return InputResponse(float(delay), float(corner), float(g), float(error[1]), float(error[2]), float(error[0]))


def corrected(frf: Frf, responses: Mapping[str, InputResponse]) -> Frf:
    """The FRF without what the inputs did to it: delays and high-passes divided out, errors with them.

    Parameters
    ----------
    frf : Frf
    responses : mapping
        Channel name -> its input's response; channels that are not named stay as they are.

    Raises
    ------
    EstimationError
        It has been corrected before.

    Notes
    -----
    Lines at 0 Hz are left out where a high-pass took them. `settings["inputs"]` says what was divided out.
    """
    names = [c.name for c in (*frf.outputs, *frf.inputs)]
    wanted = {n: r for n, r in responses.items() if n in names and (r.delay or r.highpass)}
    if not wanted:
        return frf
    if "inputs" in frf.settings:
        raise EstimationError("the inputs of this FRF have been corrected before")
    if frf.frequency[0] == 0 and any(r.highpass for r in wanted.values()):
        frf = frf.at(frf.frequency > 0)
    plain = InputResponse()
    out = np.array([wanted.get(c.name, plain).at(frf.frequency) for c in frf.outputs])
    into = np.array([wanted.get(c.name, plain).at(frf.frequency) for c in frf.inputs])
    factor = into[None] / out[:, None]
    told = {n: {"delay": r.delay, "highpass": r.highpass} for n, r in wanted.items()}
    variance = None if frf.variance is None else frf.variance * np.abs(factor) ** 2
    return replace(frf, value=frf.value * factor, variance=variance, settings={**frf.settings, "inputs": told})
