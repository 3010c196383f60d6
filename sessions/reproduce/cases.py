"""The published cases: structure, channels, bands, samples, and the errors that Atalla (1996) prints for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.bands import Band
from labnnum.errors import ConfigError
from labnnum.parameters import Parameter
from labnnum.structures.duffing import Duffing
from labnnum.structures.examples import EXAMPLES, Example, truck
from labnnum.updating.batch import FrfBatch
from labnnum.updating.many import ManyFrfs
from labnnum.updating.sweeps import ScalesBatch, SweepBatch

LINES = 60
"""Lines in each band; the dissertation does not print its own."""

Published = Mapping[str, tuple[float, float]]
"""Parameter -> mean and largest error in percent (equations 4.4, as a mean, and 4.5); NaN where not printed."""


@dataclass(frozen=True, eq=False)
class Case:
    """One row of the dissertation's tables.

    Parameters
    ----------
    name : str
    title : str
    make : callable
        Makes what computes its FRFs on given lines (Hz).
    labels : sequence of str
        Output and input of every FRF, outputs slowest.
    bands : sequence of Band
    frequency : ndarray, shape (n_f,)
        Lines in Hz.
    samples : int
        Training samples that the dissertation used.
    published : mapping
        Parameter -> (mean, largest) error in percent.
    where : str
        Section or table that prints it.
    features : str
        What our network sees.
    noisy : str
        What our network sees that is trained with noise: scores, where damping bounds them.
    """

    name: str
    title: str
    make: Callable[[NDArray[np.float64]], ManyFrfs]
    labels: tuple[str, ...]
    bands: tuple[Band, ...]
    frequency: NDArray[np.float64]
    samples: int
    published: Published
    where: str
    features: str = "log"
    noisy: str = "score"

    def solver(self) -> ManyFrfs:
        """What computes its FRFs."""
        return self.make(self.frequency)

    def with_lines(self, n: int) -> Case:
        """The same with n lines in each band, ends included; as it is where n is 0."""
        return replace(self, frequency=_in_bands(self.bands, n)) if n else self


def _in_bands(bands: Sequence[Band], n: int) -> NDArray[np.float64]:
    return np.unique(np.concatenate([np.linspace(b.low, b.high, n) for b in bands]))


def of_example(
    name: str, title: str, e: Example, published: Published, where: str, features: str = "log", noisy: str = "score"
) -> Case:
    """The case of an example with a linear structure."""
    labels = tuple(f"{o.name} / {i.name}" for o in e.outputs for i in e.inputs)
    return Case(
        name, title, lambda lines: FrfBatch.of(e.structure, lines, e.outputs, e.inputs), labels, tuple(e.bands),
        _in_bands(e.bands, LINES), e.samples, published, where, features, noisy,
    )  # fmt: skip


NOT = float("nan")


def _truck(updated: tuple[str, ...], n_outputs: int, published: Published, where: str) -> Case:
    base = EXAMPLES["truck"]()
    example = Example(truck(updated), base.outputs[:n_outputs], base.inputs, base.bands, base.samples)
    frfs = "" if len(updated) < 5 else f"-{n_outputs}frf"
    free = f"{len(updated)} parameter{'s' if len(updated) > 1 else ''}"
    title = f"Truck, {free}, {n_outputs} FRF{'s' if n_outputs > 1 else ''}"
    return of_example(f"truck-{len(updated)}{frfs}", title, example, published, where)


def _duffing(scales: bool) -> Case:
    """Forward and backward sweep; by the dissertation's multiple scales, or by harmonic balance.

    eps and the lines are ours: the dissertation prints neither.
    """
    oscillator = Duffing(epsilon=0.1)
    hertz = (1 + 0.1 * np.linspace(-1.0, 2.5, LINES + 1)) / (2 * np.pi)
    bands = tuple(Band(float(hertz[a]), float(hertz[b])) for a, b in ((0, 20), (20, 40), (40, 60)))
    make = (lambda lines: ScalesBatch(oscillator, lines)) if scales else (lambda lines: SweepBatch(oscillator, lines))
    return Case(
        "duffing-scales" if scales else "duffing-balance",
        f"Duffing oscillator, {'multiple scales' if scales else 'harmonic balance'}",
        make, ("forward", "backward"), bands, hertz, 300, _zip("mu alpha", "0.47 1.43", "6.5 19.9"), "section 5.5",
    )  # fmt: skip


def _zip(names: str, mean: str, most: str = "") -> dict[str, tuple[float, float]]:
    largest = [float(v) for v in most.split()] or [NOT] * len(names.split())
    return {n: (float(m), x) for n, m, x in zip(names.split(), mean.split(), largest, strict=True)}


_ALL = ("m3", "k2", "k3", "b2", "b3")
_FIVE = " ".join(_ALL)
_LADDER = "m11 m12 m13 m14 m15 k1 k6"


def _cases() -> dict[str, Callable[[], Case]]:
    def named(key: str, title: str, published: Published, where: str, samples: int = 0, **seen: str) -> Case:
        e = EXAMPLES[key]()
        e = Example(e.structure, e.outputs, e.inputs, e.bands, samples or e.samples)
        name = key.replace("yang-brown", "yang") + (f"-{samples}" if samples else "")
        name = "kabe-undamped" if key == "kabe" else name
        return of_example(name, title, e, published, where, **seen)

    return {
        "truck-1": lambda: _truck(("m3",), 1, _zip("m3", "0.0029"), "section 4.7"),
        "truck-2": lambda: _truck(("k2", "k3"), 1, _zip("k2 k3", "0.093 0.126"), "section 4.7"),
        "truck-4": lambda: _truck(_ALL[1:], 1, _zip("k2 k3 b2 b3", "0.734 0.348 4.57 0.824"), "section 4.7"),
        "truck-5-1frf": lambda: _truck(
            _ALL, 1, _zip(_FIVE, "2.86 0.79 2.99 5.30 2.81", "21.33 16.11 22.64 27.13 22.78"), "table 4.1"
        ),
        "truck-5-2frf": lambda: _truck(
            _ALL, 2, _zip(_FIVE, "1.59 0.66 1.63 2.73 1.95", "17.75 9.89 19.27 24.37 14.27"), "table 4.1"
        ),
        "truck-5-3frf": lambda: _truck(
            _ALL, 3, _zip(_FIVE, "1.50 0.79 1.58 2.47 2.03", "17.72 10.72 20.47 20.66 13.61"), "table 4.1"
        ),
        "kabe-undamped": lambda: named("kabe", "Kabe, undamped", _zip("k1 k5", "2.3 5.8", "31.9 46.9"), "section 5.2",
                              features="sphere", noisy="sphere"),
        "kabe-damped": lambda: named("kabe-damped", "Kabe, damped", _zip("k1 k5", "0.4 2.7", "11.9 40.0"),
                                     "section 5.2", features="sphere"),
        "yang-low-528": lambda: named(
            "yang-brown-low", "Yang and Brown, low damping, 528 samples",
            _zip(_LADDER, "1.25 0.79 1.07 1.31 1.95 0.31 0.56", "5.74 5.68 6.07 6.74 13.25 1.52 1.94"),
            "table 5.3", 528,
        ),
        "yang-low-828": lambda: named(
            "yang-brown-low", "Yang and Brown, low damping, 828 samples",
            _zip(_LADDER, "1.04 0.75 1.01 1.29 1.72 0.26 0.34", "4.33 4.85 4.37 6.32 8.07 1.20 1.40"), "table 5.3", 828,
        ),
        "yang-high-528": lambda: named(
            "yang-brown-high", "Yang and Brown, high damping, 528 samples",
            _zip(_LADDER, "1.38 1.01 1.45 1.40 1.31 1.05 1.16", "4.85 3.16 4.54 5.77 5.06 2.47 3.12"), "table 5.3", 528,
        ),
        "yang-high-828": lambda: named(
            "yang-brown-high", "Yang and Brown, high damping, 828 samples",
            _zip(_LADDER, "1.13 0.69 1.32 1.25 1.12 0.74 0.88", "4.57 2.74 3.96 4.84 4.29 1.91 2.39"), "table 5.3", 828,
        ),
        "beam": lambda: named("beam", "Cantilevered beam on a shaker",
                              _zip("m_acc I_acc alpha beta", "0.76 1.22 3.52 2.80", "11.9 35.3 82.6 86.1"),
                              "table 5.5"),
        "frame": lambda: named("frame", "Flexible frame of 96 degrees of freedom",
                               _zip("L m_bp alpha beta", "1.11 11.7 10.5 54.9", "8.19 108 231 476"), "table 5.7"),
        "duffing-scales": lambda: _duffing(True),
        "duffing-balance": lambda: _duffing(False),
    }  # fmt: skip


CASES: dict[str, Callable[[], Case]] = _cases()
"""Name -> case."""


def parameters_of(case: Case) -> tuple[Parameter, ...]:
    """Free parameters of a case."""
    return case.solver().parameters


def chosen(example: str) -> tuple[str, ...]:
    """Names of the cases that a word means: all for "", one by its name, all of an example by its beginning.

    Raises
    ------
    ConfigError
        If nothing is called so.
    """
    names = tuple(n for n in CASES if not example or n == example or n.startswith(f"{example}-"))
    if not names:
        raise ConfigError(
            f"reproduce: there is no example {example!r}; there are {', '.join(CASES)}, control, drift, flags, leakage"
        )
    return names
