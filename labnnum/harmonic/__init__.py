"""Periodic responses of structures with nonlinear laws: harmonic balance, branches followed, stability.

`HarmonicBalance` solves at one frequency (an `Orbit`) and follows the curve of responses around its folds (a `Curve`).
"""

from labnnum.harmonic.balance import HarmonicBalance
from labnnum.harmonic.curve import Curve, Orbit

__all__ = ["Curve", "HarmonicBalance", "Orbit"]
