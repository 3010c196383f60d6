"""What Welch's estimate of an FRF tends to: the model seen through the same window as the data.

A segment of finite length smears the FRF of a lightly damped structure far beyond its random error. Smeared
alike, model and measurement can be compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from labnnum.errors import EstimationError
from labnnum.windows import lag_window, window

TAIL = 1e-6
"""Share of the window's power that a banded view may miss."""

LONGEST_REACH = 32
"""Lines to either side, at most, of a banded view; windows whose power reaches further are transformed whole."""

Model = Callable[[NDArray], NDArray]
"""FRFs, shape (..., n_f), at frequencies in Hz."""


@final
class WindowView:
    r"""Linear operator from a model's FRF on a fine grid to what Welch's H1 estimates in expectation.

    Parameters
    ----------
    window : str
        Window of the segments.
    n_segment : int
        Samples in a segment.
    rate : float
        Samples per second.
    refine : int
        Points of the fine grid for each line of the estimate; lags up to (refine - 1) n_segment / rate seconds
        are exact, so the impulse response must have decayed by then. 8 suits all but the lightest damping.
    input_psd : callable or None
        Input spectral density at frequencies in Hz (any unit); None is white.
    lines : array_like, shape (n_f,), optional
        Frequencies in Hz that are wanted; all multiples of rate / n_segment if not given.
    reach : int or None
        Lines to either side from which power is gathered, the kernel scaled to sum to 1 within them. None takes
        as many as hold all but `TAIL` of the window's power and, for windows that need more than `LONGEST_REACH`
        (boxcar), all of them: then `frequency` runs from 0 to half the sample rate.
    transient : bool
        The segments are whole hits (`labnnum.spectra.Hits`) instead: the impulse response is cut at the end of
        the record, not tapered by the window's autocorrelation. The input counts as white; `reach` is not used.
    decay : float
        1/s, of an exponential window on hits: every pole moves by -decay.
    pretrigger : int
        Samples of a hit before its pulse.

    Attributes
    ----------
    frequency : ndarray, shape (n_fine,)
        Where the model must be evaluated, in Hz.
    lines : ndarray, shape (n_f,)
        Where the estimate is, in Hz.

    Notes
    -----
    For stationary random input of density S,

    .. math:: E[H_1](f) \approx \frac{\sum_m |W(f - \nu_m)|^2 S(\nu_m) H(\nu_m)}
                                     {\sum_m |W(f - \nu_m)|^2 S(\nu_m)}

    with H(-nu) = conj(H(nu)). With white input this is the transform of the impulse response times the window's
    autocorrelation, and exact on the grid; what is neglected is the bias of a ratio, of the order of
    (1 - gamma^2)/n_averages. The mean of each segment, if removed, touches the first lines only.
    With real parameters the derivative of the estimate is `apply` of the model's derivative.

    References
    ----------
    Bendat and Piersol (2010), section 11.5; Antoni and Schoukens (2007), A comprehensive study of the bias and
    variance of frequency-response-function measurements.

    Examples
    --------
    >>> view = WindowView("hann", 256, 1024.0, refine=4)
    >>> flat = view.apply(np.ones(view.frequency.size))
    >>> bool(np.allclose(flat, 1))
    True
    """

    def __init__(
        self,
        window: str,
        n_segment: int,
        rate: float,
        refine: int = 8,
        input_psd: Model | None = None,
        *,
        lines: ArrayLike | None = None,
        reach: int | None = None,
        transient: bool = False,
        decay: float = 0.0,
        pretrigger: int = 0,
    ) -> None:
        if refine < 2:
            raise EstimationError(f"refine is {refine}: the fine grid needs at least 2 points a line")
        self.window, self.n_segment, self.rate, self.refine = window, int(n_segment), float(rate), int(refine)
        step = self.rate / self.n_segment
        wanted = np.arange(self.n_segment // 2 + 1) * step if lines is None else np.asarray(lines, float)
        numbers = np.round(wanted / step).astype(int)
        if not np.allclose(numbers * step, wanted, rtol=0, atol=1e-6 * step):
            raise EstimationError(
                f"lines must be multiples of rate / n_segment = {step:g} Hz, as those of an estimate are"
            )
        if numbers.size == 0 or numbers.min() < 0 or numbers.max() > self.n_segment // 2:
            raise EstimationError("lines must lie between 0 and half the sample rate, one at least")
        if decay and not transient:
            raise EstimationError("an exponential window belongs to hits: set transient")
        if transient and not 0 <= pretrigger < self.n_segment:
            raise EstimationError(f"pretrigger {pretrigger} leaves nothing of n_segment {self.n_segment}")
        self.lines = numbers * step
        self._numbers = numbers
        self._lag = self._hit_lags(decay, pretrigger) if transient else self._welch_lags()
        self.reach = None if transient else reach if reach is not None else self._found_reach()
        self._bands = None if self.reach is None else self._banded(int(self.reach), input_psd)
        if self.reach is None:
            self.frequency = np.arange(self._size // 2 + 1) * (self.rate / self._size)
            self._density = _density(input_psd, self.frequency) if input_psd and not transient else None

    @classmethod
    def on_lines(cls, settings: Mapping[str, Any], frequency: ArrayLike, **options: Any) -> WindowView:
        """The view of the processing that `Frf.settings` describe, on the lines `frequency` (Hz).

        Parameters
        ----------
        settings : mapping
            "window", "n_segment" and "rate"; "transient", "window_decay" and "pretrigger" for hits.
        frequency : array_like, shape (n_f,)
        **options
            refine, input_psd, reach.
        """
        transient = bool(settings.get("transient") or settings.get("window_decay"))
        if transient:
            options["decay"] = float(settings.get("window_decay", 0.0))
            options["pretrigger"] = int(settings.get("pretrigger", 0))
            options["transient"] = True
        return cls(settings["window"], settings["n_segment"], settings["rate"], lines=frequency, **options)

    @property
    def _size(self) -> int:
        return self.n_segment * self.refine

    def _welch_lags(self) -> NDArray[np.float64]:
        """What the window lets through at each lag, over the whole circle, 1 at lag 0."""
        power = np.abs(np.fft.rfft(window(self.window, self.n_segment), self._size)) ** 2
        lag = np.fft.irfft(power, self._size)
        return lag / lag[0]

    def _hit_lags(self, decay: float, pretrigger: int) -> NDArray[np.float64]:
        """What a cut, decaying record lets through; a few negative lags hold what sampling rings before 0."""
        lag = np.arange(self._size)
        lag = np.where(lag < self._size - self.n_segment // 8, lag, lag - self._size)
        kept = lag < self.n_segment - pretrigger
        return np.where(kept, np.exp(-decay * np.where(kept, lag, 0) / self.rate), 0.0)

    def _found_reach(self) -> int | None:
        power = np.fft.rfft(self._lag).real.clip(0)
        by_line = np.add.reduceat(power, np.arange(0, power.size, self.refine))
        tail = np.cumsum(by_line[::-1])[::-1] / by_line.sum()
        enough = np.flatnonzero(tail < TAIL)
        longest = min(LONGEST_REACH, self.n_segment // 2)
        return int(enough[0]) if enough.size and enough[0] <= longest else None

    def _banded(self, reach: int, input_psd: Model | None) -> tuple[csr_array, csr_array]:
        """Sparse operators on the FRFs and on their conjugates (from negative frequencies); sets `frequency`."""
        if reach < 1:
            raise EstimationError(f"reach is {reach}: it must be 1 line or more")
        half = min(reach * self.refine, self._size // 2 - 1)
        offset = np.arange(-half, half + 1)
        fine = self._numbers[:, None] * self.refine + offset
        wrapped = (fine + self._size // 2) % self._size - self._size // 2
        kernel = np.fft.fft(self._lag).real[-offset % self._size]
        value = np.broadcast_to(kernel, fine.shape)
        if input_psd is not None:
            value = value * _density(input_psd, np.abs(wrapped) * (self.rate / self._size))
        value = value / value.sum(axis=1, keepdims=True)
        grid, place = np.unique(np.abs(wrapped), return_inverse=True)
        place = place.reshape(fine.shape)
        row = np.broadcast_to(np.arange(fine.shape[0])[:, None], fine.shape)
        shape = (fine.shape[0], grid.size)
        self.frequency = grid * (self.rate / self._size)
        positive = wrapped >= 0
        return _sparse(value, row, place, positive, shape), _sparse(value, row, place, ~positive, shape)

    def apply(self, fine: NDArray) -> NDArray[np.complex128]:
        """FRFs as estimated, shape (..., n_f), from FRFs at `frequency`, shape (..., n_fine)."""
        fine = np.asarray(fine)
        if fine.shape[-1:] != self.frequency.shape:
            raise EstimationError(f"FRFs of shape {fine.shape} do not fit the grid of {self.frequency.size} points")
        if not np.isfinite(fine).all():
            at = self.frequency[np.flatnonzero(~np.isfinite(fine.reshape(-1, fine.shape[-1])).all(axis=0))[0]]
            raise EstimationError(
                f"the model's FRF is not finite at {at:g} Hz; see an unsupported structure as accelerance"
            )
        return self._whole(fine) if self._bands is None else self._gather(fine, *self._bands)

    def _gather(self, fine: NDArray, direct: csr_array, mirror: csr_array) -> NDArray[np.complex128]:
        flat = fine.reshape(-1, fine.shape[-1]).T
        out = direct @ flat
        if mirror.nnz:
            out = out + mirror @ flat.conj()
        return np.ascontiguousarray(out.T, complex).reshape(*fine.shape[:-1], self.lines.size)

    def _whole(self, fine: NDArray) -> NDArray[np.complex128]:
        if self._density is None:
            return self._smear(fine)
        return self._smear(fine * self._density) / np.real(self._smear(self._density))

    def _smear(self, fine: NDArray) -> NDArray[np.complex128]:
        impulse = np.fft.irfft(fine, self._size, axis=-1) * self._lag
        return np.fft.rfft(impulse, axis=-1)[..., :: self.refine][..., self._numbers]


def _density(input_psd: Model, frequency: NDArray) -> NDArray[np.float64]:
    flat, place = np.unique(frequency, return_inverse=True)
    density = np.asarray(input_psd(flat), float)
    if density.shape != flat.shape or not np.isfinite(density).all() or (density < 0).any():
        raise EstimationError("the input density must be finite, not negative, one value a frequency")
    floor = 1e-9 * density.max()
    return np.maximum(density, floor)[place.reshape(frequency.shape)]


def _sparse(value: NDArray, row: NDArray, column: NDArray, keep: NDArray, shape: tuple[int, int]) -> csr_array:
    return csr_array((value[keep], (row[keep], column[keep])), shape=shape)


def view_of(
    settings: Mapping[str, Any],
    lines: ArrayLike | None = None,
    *,
    refine: int = 8,
    input_psd: Model | None = None,
    reach: int | None = None,
) -> WindowView | None:
    """View through the processing that made an estimate, or None where that does not smear.

    Parameters
    ----------
    settings : mapping
        `Frf.settings`. Imported FRFs, whose window is unknown, and whole periods and bursts, which do not leak,
        give None.
    lines : array_like, optional
        Frequencies of the estimate, in Hz.
    refine, input_psd, reach
        As for `WindowView`.
    """
    name, n, rate = settings.get("window"), settings.get("n_segment"), settings.get("rate")
    if settings.get("periodic") or settings.get("burst") or not (isinstance(name, str) and n and rate):
        return None
    if lines is None:
        lines = np.arange(int(n) // 2 + 1) * (float(rate) / int(n))
    return WindowView.on_lines(settings, lines, refine=refine, input_psd=input_psd, reach=reach)


def seen_through(
    model: Model | tuple[ArrayLike, ArrayLike],
    settings: Mapping[str, Any],
    lines: ArrayLike | None = None,
    *,
    refine: int | None = None,
    input_psd: Model | None = None,
    reach: int | None = None,
) -> NDArray[np.complex128]:
    """The model's FRFs as an estimate with these settings shows them in expectation, shape (..., n_f).

    Parameters
    ----------
    model : callable, or (poles, residues)
        FRFs, shape (..., n_f), at frequencies in Hz; or poles in rad/s, shape (n,), one of each conjugate pair,
        and residues, shape (..., n), of sum_r R_r/(s - p_r) + conj(R_r)/(s - conj(p_r)).
    settings : mapping
        `Frf.settings`.
    lines : array_like, optional
        Frequencies in Hz, multiples of rate / n_segment; all if not given.
    refine : int, optional
        As for `WindowView`; with poles enough for the slowest of them if not given, else 8.
    input_psd, reach
        As for `WindowView`.

    Examples
    --------
    >>> pole = 2 * np.pi * 100 * (-0.002 + 1j)
    >>> settings = {"window": "hann", "n_segment": 1024, "rate": 1024.0}
    >>> peak = seen_through(([pole], [1.0]), settings, [100.0])
    >>> exact = 1 / (2j * np.pi * 100 - pole) + 1 / (2j * np.pi * 100 - np.conj(pole))
    >>> float(round(abs(peak[0] / exact), 3))
    0.329
    """
    if not callable(model):
        poles, residues = np.asarray(model[0], complex), np.asarray(model[1], complex)
        refine = refine or refine_for(poles, settings)
        function: Model = modal_frf(poles, residues)
    else:
        function = model
    view = view_of(settings, lines, refine=refine or 8, input_psd=input_psd, reach=reach)
    if view is None:
        if lines is None:
            raise EstimationError("these settings do not smear, so the lines must be given")
        return np.asarray(function(np.asarray(lines, float)))
    return view.apply(np.asarray(function(view.frequency)))


def modal_frf(poles: NDArray, residues: NDArray) -> Model:
    """FRF, as a function of Hz, of poles (n,) and residues (..., n), each with its conjugate."""

    def frf(frequency: NDArray) -> NDArray:
        s = 2j * np.pi * np.asarray(frequency, float)
        direct = residues @ (1 / (s - poles[:, None]))
        return direct + residues.conj() @ (1 / (s - poles.conj()[:, None]))

    return frf


def refine_for(poles: ArrayLike, settings: Mapping[str, Any], share: float = 1e-4) -> int:
    """Fine points a line after which the slowest pole has decayed to `share`, 4 to 64."""
    slowest = float(np.abs(np.real(np.asarray(poles))).min())
    length = float(settings["n_segment"]) / float(settings["rate"])
    need = -np.log(share) / (slowest * length) if slowest > 0 else np.inf
    return int(np.clip(np.ceil(need) + 1, 4, 64))


def lag_transform(
    impulse: NDArray, name: str, n_segment: int, lines: Sequence[int] | NDArray | None = None
) -> NDArray[np.complex128]:
    r"""Expected H1 for white input from a causal impulse response, exactly, shape (..., n_f).

    Parameters
    ----------
    impulse : ndarray, shape (..., n)
        h_k, samples of the discrete system; beyond lag n_segment - 1 they do not matter.
    name, n_segment
        Window of the segments.
    lines : sequence of int, optional
        Multiples of rate / n_segment; all if not given.

    Notes
    -----
    .. math:: E[S_{fx}](f)/S_{ff} = \sum_k v_k h_k e^{-2\pi i f k / r}

    with v the window's autocorrelation: of each lag, the window lets that share through.
    """
    lags = lag_window(name, n_segment)
    kept = np.zeros((*impulse.shape[:-1], n_segment))
    count = min(n_segment, impulse.shape[-1])
    kept[..., :count] = impulse[..., :count] * lags[:count]
    spectrum = np.fft.rfft(kept, axis=-1)
    return spectrum if lines is None else spectrum[..., np.asarray(lines, int)]
