"""Units: published factors, words that depend on the quantity, and what is refused."""

import pytest

from labnnum.errors import UnitError
from labnnum.recording import SI_UNITS
from sessions.units import calibration, conversion, infer_quantity, normal

INCH, GRAVITY, POUND = 0.0254, 9.80665, 0.45359237  # exact by definition


@pytest.mark.parametrize(
    ("unit", "quantity", "factor"),
    [
        ("in", "displacement", INCH),
        ("mil", "displacement", INCH / 1000),
        ("mm", "displacement", 1e-3),
        ("µm", "displacement", 1e-6),
        ("in/s", "velocity", INCH),
        ("ips", "velocity", INCH),
        ("g", "acceleration", GRAVITY),
        ("mg", "acceleration", GRAVITY / 1000),
        ("mm/s²", "acceleration", 1e-3),
        ("in/s^2", "acceleration", INCH),
        ("lb", "force", POUND * GRAVITY),
        ("lbf", "force", POUND * GRAVITY),
        ("kip", "force", 1000 * POUND * GRAVITY),
        ("kgf", "force", GRAVITY),
        ("kN", "force", 1e3),
        ("lbf*ft", "moment", POUND * GRAVITY * 12 * INCH),
        ("psi", "pressure", POUND * GRAVITY / INCH**2),
        ("deg", "angle", 3.141592653589793 / 180),
        ("rpm", "angular_velocity", 3.141592653589793 / 30),
        ("microstrain", "strain", 1e-6),
        ("ue", "strain", 1e-6),
        ("%", "dimensionless", 1e-2),
        ("mV", "voltage", 1e-3),
        ("K", "temperature", 1.0),
    ],
)
def test_published_factors(unit, quantity, factor):
    assert conversion(unit, quantity).scale == pytest.approx(factor, rel=1e-12)
    assert conversion(unit, quantity).offset == 0


@pytest.mark.parametrize(("quantity", "si"), SI_UNITS.items())
def test_si_is_one(quantity, si):
    assert conversion(si, quantity).scale == conversion("", quantity).scale == 1.0
    assert infer_quantity(si) in SI_UNITS


def test_fahrenheit_and_celsius():
    for unit, reading, kelvin in (("degF", 32.0, 273.15), ("°C", 100.0, 373.15), ("degF", -40.0, 233.15)):
        c = conversion(unit, "temperature")
        assert (reading - c.offset) * c.scale == pytest.approx(kelvin, abs=1e-9)


@pytest.mark.parametrize("same", ["m/s2", "m/s^2", "m/s**2", "m/s²"])
def test_spellings(same):
    assert normal(same) == "m/s^2"


@pytest.mark.parametrize(
    ("sensitivity", "unit", "quantity", "volts_per_si", "raw_volts"),
    [
        ("100 mV/g", "", "acceleration", 0.1 / GRAVITY, 1.0),
        ("100 mV/g", "mV", "acceleration", 0.1 / GRAVITY, 1e-3),
        (0.1, "g", "acceleration", 0.1 / GRAVITY, 1.0),
        (0.01, "V", "acceleration", 0.01, 1.0),
        (0.01, "", "acceleration", 0.01, 1.0),
        ("2.25 mV/N", "N", "force", 2.25e-3, 1.0),
        ("10 mV/lbf", "", "force", 0.01 / (POUND * GRAVITY), 1.0),
        ("98.0665 (m/s^2)/V", "", "acceleration", 1 / 98.0665, 1.0),
    ],
)
def test_sensitivities(sensitivity, unit, quantity, volts_per_si, raw_volts):
    c = calibration(sensitivity, unit, quantity)
    assert c.sensitivity == pytest.approx(volts_per_si, rel=1e-12)
    assert c.scale == pytest.approx(raw_volts / volts_per_si, rel=1e-12)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: conversion("foo", "force", "channel 'f': "), r"^channel 'f': unit 'foo' is unknown"),
        (lambda: conversion("N", "acceleration"), "unit 'N' does not measure acceleration"),
        (lambda: conversion("kg", "acceleration"), "does not measure"),
        (lambda: conversion("m/(s", "velocity"), "is unknown"),
        (lambda: calibration("100 pC/N", "", "force"), "is not volts per force"),
        (lambda: calibration("mV/g", "", "acceleration"), "must be a number with units"),
        (lambda: calibration(0.0, "", "acceleration"), "other than 0"),
        (lambda: calibration(0.1, "N", "acceleration"), "does not measure"),
    ],
)
def test_refused(call, words):
    with pytest.raises(UnitError, match=words):
        call()
