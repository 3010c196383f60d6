"""Units of any system at the boundary: how many SI units one raw unit is. SI everywhere inside."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from tokenize import TokenError
from typing import Any

from labnnum.errors import UnitError
from labnnum.recording import SI_UNITS

_SPELLING = ((r"²", "^2"), (r"³", "^3"), (r"[·⋅×]", "*"), (r"µ|μ", "u"), (r"\bsec\b", "s"), (r"°", "deg"))
_POWER = re.compile(r"(?<=[A-Za-z])([23])(?![\w.])")

_CONTEXT: dict[str, dict[str, str]] = {
    "acceleration": {"g": "g_0", "gn": "g_0", "G": "g_0", "gee": "g_0", "mg": "mg_0", "Gal": "cm/s^2"},
    "force": {"lb": "lbf", "lbs": "lbf", "kg": "kgf", "oz": "ozf", "klb": "kip", "klbf": "kip"},
    "moment": {"lb": "lbf", "lbs": "lbf", "kg": "kgf", "oz": "ozf"},
    "displacement": {"mil": "thou", "mils": "thou"},
    "velocity": {"ips": "in/s", "fps": "ft/s", "mil": "thou"},
    "strain": {"ue": "microstrain", "uε": "microstrain", "ustrain": "microstrain"},
    "temperature": {"C": "degC", "F": "degF"},
}
"""What a word means where it measures that quantity: "g" is a gram only where mass is meant."""

_INFERRED = (
    "acceleration", "force", "velocity", "displacement", "voltage", "pressure",
    "angular_acceleration", "angular_velocity", "temperature", "moment",
)  # fmt: skip
_SI_NAMES = {**{unit: quantity for quantity, unit in reversed(SI_UNITS.items())}, "1": "dimensionless"}


@dataclass(frozen=True, slots=True)
class Conversion:
    """SI = (raw - offset) * scale; `sensitivity` in volts per SI unit where raw is a voltage, else None."""

    scale: float
    offset: float = 0.0
    sensitivity: float | None = None


def normal(unit: str) -> str:
    """A unit in the spelling that `SI_UNITS` uses.

    Examples
    --------
    >>> normal("m/s2"), normal("mm/s²"), normal("N·m")
    ('m/s^2', 'mm/s^2', 'N*m')
    """
    text = unit.strip().replace("**", "^")
    for pattern, plain in _SPELLING:
        text = re.sub(pattern, plain, text)
    return _POWER.sub(r"^\1", text)


def conversion(unit: str, quantity: str, where: str = "") -> Conversion:
    """How samples in `unit` become the SI unit of `quantity`.

    Parameters
    ----------
    unit : str
        Such as "g", "lbf", "mil", "mm/s²"; empty for SI.
    quantity : str
        A key of `SI_UNITS`; it decides what "g", "lb" and "mil" mean.
    where : str
        Begins the message of an error.

    Raises
    ------
    UnitError
        If the unit is unknown or measures something else.

    Examples
    --------
    >>> conversion("g", "acceleration").scale
    9.80665
    >>> conversion("degC", "temperature")
    Conversion(scale=1.0, offset=-273.15, sensitivity=None)
    """
    text, si = normal(unit), SI_UNITS[quantity]
    if text in ("", si):
        return Conversion(1.0)
    registry = _registry()
    parsed = _parse(text, quantity, where)
    target = registry.Unit(si) if si != "1" else registry.Unit("")
    if parsed.dimensionality != target.dimensionality:
        raise UnitError(f"{where}unit {unit!r} does not measure {quantity} (in SI: {si}); correct unit or quantity")
    if quantity == "temperature":
        zero = registry.Quantity(0.0, parsed).to(target).magnitude
        scale = float(registry.Quantity(1.0, f"delta_{parsed}").to(target).magnitude) if zero else _times(parsed, si)
        return Conversion(scale, -float(zero) / scale if zero else 0.0)
    return Conversion(_times(parsed, si))


def calibration(sensitivity: float | str, unit: str, quantity: str, where: str = "") -> Conversion:
    """How volts become the SI unit of `quantity`, by a sensor's sensitivity.

    Parameters
    ----------
    sensitivity : float or str
        A number is volts per `unit`, or volts per SI unit if `unit` is a voltage (which the samples are then in).
        A text has its own units: "100 mV/g", "2.25 mV/N", also inverted, "9.81 (m/s^2)/V".

    Examples
    --------
    >>> round(calibration("100 mV/g", "", "acceleration").sensitivity, 9)
    0.010197162
    >>> calibration(0.01, "mV", "force").scale
    0.1
    """
    volts = _voltage(unit, quantity)
    per_si = 0.0
    if isinstance(sensitivity, str):
        per_si = _parsed_sensitivity(sensitivity, quantity, where)
    else:
        per_si = float(sensitivity) / (1.0 if volts else conversion(unit, quantity, where).scale)
    if not per_si or not math.isfinite(per_si):
        raise UnitError(f"{where}sensitivity {sensitivity!r} must be a finite number other than 0, in volts per unit")
    return Conversion((volts or 1.0) / per_si, 0.0, per_si)


def infer_quantity(unit: str) -> str:
    """The quantity that a unit measures; "" if it tells nothing.

    Examples
    --------
    >>> infer_quantity("m/s2"), infer_quantity("lbf"), infer_quantity("g"), infer_quantity("furlong^7")
    ('acceleration', 'force', 'acceleration', '')
    """
    text = normal(unit)
    if not text:
        return ""
    if text in _SI_NAMES:
        return _SI_NAMES[text]
    for quantity in _INFERRED:
        try:
            conversion(text, quantity)
        except UnitError:
            continue
        return quantity
    return "strain" if text in _CONTEXT["strain"] or text == "microstrain" else ""


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


def _parse(text: str, quantity: str, where: str) -> Any:
    import pint

    words = _CONTEXT.get(quantity, {})
    told = re.sub(r"[A-Za-zε_]\w*", lambda m: f"({words[m[0]]})" if m[0] in words else m[0], text)
    try:
        return _registry().parse_units(told)
    except (pint.errors.PintError, TokenError, ValueError, TypeError, AttributeError, SyntaxError) as error:
        raise UnitError(
            f"{where}unit {text!r} is unknown; write it as in 'm/s^2', 'g', 'N', 'lbf', 'mm/s', 'mil', 'mV'"
        ) from error


def _times(parsed: Any, si: str) -> float:
    return float(_registry().Quantity(1.0, parsed).to(si if si != "1" else "").magnitude)


def _voltage(unit: str, quantity: str) -> float:
    """Volts per `unit` where it is a voltage and the quantity is not; else 0."""
    if quantity == "voltage" or not unit:
        return 0.0
    try:
        return conversion(unit, "voltage").scale
    except UnitError:
        return 0.0


def _parsed_sensitivity(text: str, quantity: str, where: str) -> float:
    match = re.match(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*\*?\s*(.+)$", text)
    if match is None:
        raise UnitError(f"{where}sensitivity {text!r} must be a number with units, such as '100 mV/g'")
    unit = _parse(normal(match[2]), quantity, where)
    registry = _registry()
    si = registry.Unit(SI_UNITS[quantity] if SI_UNITS[quantity] != "1" else "")
    value = registry.Quantity(float(match[1]), unit)
    for target, power in ((registry.volt / si, 1), (si / registry.volt, -1)):
        if unit.dimensionality == target.dimensionality:
            return float(value.to(target).magnitude) ** power
    raise UnitError(f"{where}sensitivity {text!r} is not volts per {quantity}, such as '100 mV/g' or '2.25 mV/N'")
