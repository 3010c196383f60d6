"""From what a user knows about a beam to the four constants that its equation needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from labnnum.errors import ConfigError
from labnnum.structures.quantities import Quantity, Values


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """Material and cross-section of a beam, by whichever of these quantities are known.

    Bending stiffness comes from EI, else E and I, else wave; mass per length from rhoA, else mass over length, else
    rho and A; A from width and height (a rectangle, bending along its height) or diameter and bore (a tube); shear
    stiffness from kGA, else kappa, G (or E and nu) and A; rotary inertia per length from rhoI, else rho and I.

    Parameters
    ----------
    E, G : float or str
        Young's and shear modulus, Pa.
    nu : float or str
        Poisson's ratio, used where G is not given.
    rho : float or str
        Density, kg/m^3.
    width, height, diameter, bore : float or str
        m.
    A, I : float or str
        Area, m^2, and second moment of area, m^4.
    EI, rhoA, kGA, rhoI : float or str
        N m^2, kg/m, N, kg m.
    wave : float or str
        sqrt(EI / rhoA), m^2/s.
    mass : float or str
        Of the beam without attachments, kg.
    kappa : float or str
        Shear coefficient; 5/6 unless given.
    """

    E: Quantity | None = None
    G: Quantity | None = None
    nu: Quantity | None = None
    rho: Quantity | None = None
    width: Quantity | None = None
    height: Quantity | None = None
    diameter: Quantity | None = None
    bore: Quantity | None = None
    A: Quantity | None = None
    I: Quantity | None = None  # noqa: E741
    EI: Quantity | None = None
    rhoA: Quantity | None = None
    kGA: Quantity | None = None
    rhoI: Quantity | None = None
    wave: Quantity | None = None
    mass: Quantity | None = None
    kappa: Quantity | None = None

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Quantities that are given."""
        return tuple(q for q in (getattr(self, f.name) for f in fields(self)) if q is not None)


@dataclass(frozen=True, slots=True)
class Constants:
    """Bending stiffness N m^2, mass per length kg/m, shear stiffness N, rotary inertia per length kg m."""

    EI: Any
    rhoA: Any
    kGA: Any
    rhoI: Any


def constants(section: Section, values: Values, length: Any, shear: bool) -> Constants:
    """The constants at these parameter values; without `shear` those of Euler and Bernoulli (kGA inf, rhoI 0).

    Raises
    ------
    ConfigError
        Naming what is missing.
    """
    known = {f.name: values.at(q) for f in fields(section) if (q := getattr(section, f.name)) is not None}
    _geometry(known)
    rhoA = _first(known, _mass_rules(known, length))
    if rhoA is None:
        raise ConfigError("the beam's mass is unknown: give rhoA, or mass, or rho with A (or width and height)")
    if "A" not in known and "rho" in known:
        known["A"] = rhoA / known["rho"]
    EI = _stiffness(known, rhoA)
    if not shear:
        return Constants(EI, rhoA, np.inf, 0.0)
    gyration = _gyration(known, EI, rhoA)
    return Constants(EI, rhoA, _shear(known), known.get("rhoI", rhoA * gyration))


def _geometry(known: dict[str, Any]) -> None:
    if {"width", "height"} <= known.keys():
        known.setdefault("A", known["width"] * known["height"])
        known.setdefault("I", known["width"] * known["height"] ** 3 / 12)
    elif "diameter" in known:
        bore = known.get("bore", 0.0)
        known.setdefault("A", np.pi / 4 * (known["diameter"] ** 2 - bore**2))
        known.setdefault("I", np.pi / 64 * (known["diameter"] ** 4 - bore**4))


def _mass_rules(known: Mapping[str, Any], length: Any) -> Iterable[tuple[tuple[str, ...], Any]]:
    yield ("rhoA",), lambda: known["rhoA"]
    yield ("mass",), lambda: known["mass"] / length
    yield ("rho", "A"), lambda: known["rho"] * known["A"]


def _first(known: Mapping[str, Any], rules: Iterable[tuple[tuple[str, ...], Any]]) -> Any:
    for needs, rule in rules:
        if all(n in known for n in needs):
            return rule()
    return None


def _stiffness(known: Mapping[str, Any], rhoA: Any) -> Any:
    rules = (
        (("EI",), lambda: known["EI"]),
        (("wave",), lambda: known["wave"] ** 2 * rhoA),
        (("E", "I"), lambda: known["E"] * known["I"]),
    )
    found = _first(known, rules)
    if found is None:
        raise ConfigError(
            "the beam's bending stiffness is unknown: give EI, or E with I (or width and height), or wave"
        )
    return found


def _gyration(known: Mapping[str, Any], EI: Any, rhoA: Any) -> Any:
    """Squared radius of gyration of the section."""
    rules = (
        (("rhoI",), lambda: known["rhoI"] / rhoA),
        (("I", "A"), lambda: known["I"] / known["A"]),
        (("E", "rho"), lambda: EI / rhoA * known["rho"] / known["E"]),
    )
    found = _first(known, rules)
    if found is None:
        raise ConfigError(
            "a Timoshenko beam needs its section's size: give rhoI, or I and A, or width and height, or E and rho"
        )
    return found


def _shear(known: Mapping[str, Any]) -> Any:
    kappa = known.get("kappa", 5 / 6)
    rules = (
        (("kGA",), lambda: known["kGA"]),
        (("G", "A"), lambda: kappa * known["G"] * known["A"]),
        (("E", "nu", "A"), lambda: kappa * known["E"] / (2 * (1 + known["nu"])) * known["A"]),
    )
    found = _first(known, rules)
    if found is None:
        raise ConfigError("a Timoshenko beam needs its shear stiffness: give kGA, or G (or E and nu) with the area A")
    return found
