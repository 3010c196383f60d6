"""Numbers as people read them."""

from __future__ import annotations

import math
import re
import time

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def with_error(value: float, std: float, unit: str = "") -> str:
    """A value with its standard deviation to two digits, in powers of a thousand where that helps.

    Examples
    --------
    >>> with_error(0.010234, 0.000042, "kg")
    '(10.234 ± 0.042) ×10⁻³ kg'
    >>> with_error(1.5, 0.12)
    '1.50 ± 0.12'
    >>> with_error(3.0, 0.0, "m")
    '3 m'
    """
    shown_unit = "" if unit in ("", "1") else f" {pretty_unit(unit)}"
    if not (math.isfinite(value) and math.isfinite(std)) or std <= 0:
        return f"{value:.6g}{shown_unit}"
    power = _thousands(value if abs(value) > std else std)
    digits = max(0, 1 - math.floor(math.log10(std / 10.0**power)))
    text = f"{value / 10.0**power:.{digits}f} ± {std / 10.0**power:.{digits}f}"
    return f"({text}) {_times(power)}{shown_unit}" if power else f"({text}){shown_unit}" if shown_unit else text


def quantity(value: float, unit: str = "", digits: int = 4) -> str:
    """A value with a few digits, in powers of a thousand where that helps.

    Examples
    --------
    >>> quantity(2e-5, "s")
    '20 ×10⁻⁶ s'
    >>> quantity(12.5, "Hz")
    '12.5 Hz'
    """
    shown_unit = "" if unit in ("", "1") else f" {pretty_unit(unit)}"
    if not math.isfinite(value) or value == 0:
        return f"{value:g}{shown_unit}"
    power = _thousands(value)
    text = f"{value / 10.0**power:.{digits}g}"
    return f"{text} {_times(power)}{shown_unit}" if power else f"{text}{shown_unit}"


def percent(value: float, digits: int = 2) -> str:
    """A share in percent; a dash where there is none.

    Examples
    --------
    >>> percent(0.01234), percent(1.0712), percent(float("nan"))
    ('1.2 %', '107 %', '–')
    """
    if not math.isfinite(value):
        return "–"
    text = f"{100 * value:.{digits}g}"
    return f"{100 * value:.0f} %" if "e+" in text else f"{text} %"


def pretty_unit(unit: str) -> str:
    """A unit with raised powers and a middle dot.

    Examples
    --------
    >>> pretty_unit("kg*m^2")
    'kg·m²'
    """
    raised = re.sub(r"(?:\^|\*\*)(-?\d+)", lambda power: power[1].translate(_SUPERSCRIPT), unit)
    return raised.replace("*", "·")


def date(seconds: float) -> str:
    """Local date and time of `seconds` since the epoch.

    Examples
    --------
    >>> len(date(0.0))
    16
    """
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(seconds))


def _thousands(value: float) -> int:
    if 0.1 <= abs(value) < 1e5:
        return 0
    return 3 * math.floor(math.log10(abs(value)) / 3)


def _times(power: int) -> str:
    return f"×10{str(power).translate(_SUPERSCRIPT)}"
