"""Frequency response functions with everything needed to trust them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError, EstimationError, QualityError
from labnnum.recording import Channel, readonly

MOTION_ORDER = {
    "displacement": 0,
    "velocity": 1,
    "acceleration": 2,
    "angle": 0,
    "angular_velocity": 1,
    "angular_acceleration": 2,
}
"""How many times each motion quantity is differentiated from displacement."""

_MOTION_NAMES = (
    ("displacement", "velocity", "acceleration"),
    ("angle", "angular_velocity", "angular_acceleration"),
)


@dataclass(frozen=True, eq=False)
class Frf:
    """Frequency response functions, their coherence and their random error, kept together.

    Parameters
    ----------
    frequency : array_like, shape (n_f,)
        Lines, in Hz, ascending; not necessarily even.
    value : array_like, shape (n_out, n_in, n_f)
        Complex response over input, SI units, time factor exp(+i omega t).
    outputs, inputs : sequence of Channel
    coherence : array_like, shape (n_out, n_f), or None
        Ordinary coherence with one input, multiple coherence with several.
    variance : array_like, shape (n_out, n_in, n_f), or None
        E|dH|^2, total over real and imaginary part, random error only.
    n_averages : float
        Effective number of independent averages; NaN where unknown (an imported FRF).
    estimator : str
        "H1", "H2", "Hv", "periodic", "model" or "imported".
    settings : mapping
        Window, n_segment, overlap, rate, damping added by windows and whatever else made it, so that the
        model can be seen through the same processing. Keys used elsewhere: "window" (str), "n_segment" (int),
        "overlap" (float), "rate" (float), "window_decay" (1/s, by the exponential window).
    input_spectrum : array_like, shape (n_in, n_in, n_f), or None
        Averaged auto- and cross-spectra of the inputs, unit^2/Hz.
    input_condition : array_like, shape (n_f,), or None
        Condition number of the scaled input spectrum matrix, several inputs only.
    shared : array_like, shape (n_out, n_in, n_f), or None
        Factor, at least one, by which `variance` must be raised where responses are taken for independent, so that it
        covers the noise of the measured input, which all of them share. None where that is not known.
    """

    frequency: NDArray[np.float64]
    value: NDArray[np.complex128]
    outputs: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    coherence: NDArray[np.float64] | None = None
    variance: NDArray[np.float64] | None = None
    n_averages: float = float("nan")
    estimator: str = "imported"
    settings: dict[str, Any] = field(default_factory=dict)
    input_spectrum: NDArray[np.complex128] | None = None
    input_condition: NDArray[np.float64] | None = None
    shared: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "outputs", tuple(self.outputs))
        object.__setattr__(self, "inputs", tuple(self.inputs))
        f = readonly(self.frequency)
        object.__setattr__(self, "frequency", f)
        object.__setattr__(self, "value", readonly(self.value, complex))
        expected = (len(self.outputs), len(self.inputs), f.size)
        if self.value.shape != expected:
            raise EstimationError(
                f"an Frf of shape {self.value.shape} does not fit (outputs, inputs, lines) {expected}"
            )
        if f.size > 1 and not (np.diff(f) > 0).all():
            raise EstimationError("the frequency axis of an Frf must ascend")
        for name, kind in (
            ("coherence", float),
            ("variance", float),
            ("input_spectrum", complex),
            ("input_condition", float),
            ("shared", float),
        ):
            array = getattr(self, name)
            if array is not None:
                object.__setattr__(self, name, readonly(array, kind))

    @property
    def omega(self) -> NDArray[np.float64]:
        """Lines in rad/s, shape (n_f,)."""
        return 2 * np.pi * self.frequency

    @property
    def covering_variance(self) -> NDArray[np.float64] | None:
        """`variance` raised by `shared`, for fits that take responses for independent."""
        return self.variance if self.variance is None or self.shared is None else self.variance * self.shared

    @property
    def error_magnitude(self) -> NDArray[np.float64] | None:
        """Normalised random error of |H| (standard deviation over magnitude), shape (n_out, n_in, n_f).

        Half of the complex variance lies along the phasor. Bendat and Piersol (2010), table 9.6.
        """
        if self.variance is None:
            return None
        size = np.abs(self.value)
        return np.sqrt(self.variance / 2) / np.where(size > 0, size, np.inf)

    @property
    def error_phase(self) -> NDArray[np.float64] | None:
        """Random error of the phase, in rad (small-error approximation), shape (n_out, n_in, n_f)."""
        return self.error_magnitude

    def lines(self, low: float, high: float) -> Frf:
        """The same FRFs on the lines with low <= f <= high."""
        return self.at((self.frequency >= low) & (self.frequency <= high))

    def rows(self, outputs: Sequence[int]) -> Frf:
        """The same FRFs of these outputs, by number, in this order."""
        pick = list(outputs)

        def cut(a: NDArray | None) -> NDArray | None:
            return None if a is None else a[pick]

        return replace(
            self, value=self.value[pick], outputs=tuple(self.outputs[i] for i in pick), variance=cut(self.variance),
            coherence=cut(self.coherence), shared=cut(self.shared),
        )  # fmt: skip

    def at(self, mask: NDArray) -> Frf:
        """The same FRFs on the lines that `mask` (boolean or index, shape (n_f,)) chooses."""

        def cut(a: NDArray | None) -> NDArray | None:
            return None if a is None else a[..., mask]

        return replace(
            self,
            frequency=self.frequency[mask],
            value=self.value[..., mask],
            coherence=cut(self.coherence),
            variance=cut(self.variance),
            input_spectrum=cut(self.input_spectrum),
            input_condition=cut(self.input_condition),
            shared=cut(self.shared),
        )

    def output(self, name: str) -> int:
        """Row of the response channel called `name`."""
        for i, channel in enumerate(self.outputs):
            if channel.name == name:
                return i
        raise ChannelError(f"the FRF has no response {name!r}; it has {', '.join(c.name for c in self.outputs)}")

    def convert(self, quantity: str) -> Frf:
        """Receptance, mobility or accelerance: responses as "displacement", "velocity" or "acceleration".

        Rotations become "angle", "angular_velocity" or "angular_acceleration". A line at zero hertz is
        dropped when it would have to be divided by zero.
        """
        if quantity not in ("displacement", "velocity", "acceleration"):
            raise ChannelError(
                f"cannot convert responses to {quantity!r}: expected displacement, velocity, acceleration"
            )
        if any(c.quantity not in MOTION_ORDER for c in self.outputs):
            odd = next(c for c in self.outputs if c.quantity not in MOTION_ORDER)
            raise ChannelError(f"channel {odd.name!r} measures {odd.quantity}, which is not a motion")
        power = np.array([MOTION_ORDER[quantity] - MOTION_ORDER[c.quantity] for c in self.outputs])
        source = self
        if (power < 0).any() and self.frequency.size and self.frequency[0] == 0:
            source = self.at(self.frequency > 0)
        factor = (1j * source.omega)[None, :] ** power[:, None]
        outputs = tuple(
            replace(c, quantity=_MOTION_NAMES[c.quantity.startswith("ang")][MOTION_ORDER[quantity]])
            for c in self.outputs
        )
        variance = None if source.variance is None else source.variance * np.abs(factor[:, None, :]) ** 2
        return replace(source, value=source.value * factor[:, None, :], outputs=outputs, variance=variance)

    def require_coherence(self, threshold: float, bands: Sequence[Any] = ()) -> Frf:
        """Return self if the mean coherence reaches `threshold` for every response (in every band).

        Raises
        ------
        QualityError
            Naming the channel, the band and the likely cause, or that a single average makes coherence
            meaningless.
        """
        from labnnum.quality import coherence_verdicts

        bad = [v for v in coherence_verdicts(self, threshold, bands) if not v.ok]
        if bad:
            raise QualityError("; ".join(v.reason for v in bad))
        return self
