"""The tables that every model.toml has, whatever the kind of its structure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, FiniteFloat

from labnnum.bands import Band
from labnnum.errors import ConfigError
from labnnum.parameters import Parameter
from labnnum.structures import Structure
from labnnum.structures.quantities import Damping
from sessions.toml import Table

Text = Annotated[str, BeforeValidator(lambda v: str(v) if isinstance(v, int) and not isinstance(v, bool) else v)]
"""A node's name; whole numbers may be written without quotes."""

Quantity = float | str
Point3 = tuple[float, float, float]
Axis = Literal["x", "y", "z"]
Base = Literal["", "x", "y", "z"]


class DampingTable(Table):
    """[damping]."""

    kind: Literal["none", "proportional", "modal", "structural", "matrix"]
    alpha: Quantity | None = None
    beta: Quantity | None = None
    eta: Quantity | None = None
    ratio: Quantity | tuple[Quantity, ...] | None = None

    def build(self) -> Damping:
        """The damping; ConfigError for a key that its kind does not know."""
        allowed = {"proportional": ("alpha", "beta"), "modal": ("ratio",), "structural": ("eta",)}.get(self.kind, ())
        given = {k: v for k in ("alpha", "beta", "eta", "ratio") if (v := getattr(self, k)) is not None}
        for key in given:
            if key not in allowed:
                does = f"takes {' and '.join(allowed)}" if allowed else "takes no value"
                raise ConfigError(f"damping.{key}: damping of kind {self.kind} {does}")
        for key in allowed if self.kind != "proportional" else ():
            if key not in given:
                raise ConfigError(f"damping.{key} is missing: damping of kind {self.kind} needs it")
        if "ratio" in given and not isinstance(given["ratio"], tuple):
            given["ratio"] = (given["ratio"],)
        return Damping(self.kind, **given)


class ParameterTable(Table):
    """One [[parameter]]."""

    name: str = Field(min_length=1)
    nominal: FiniteFloat
    lower: FiniteFloat
    upper: FiniteFloat
    std: FiniteFloat | None = None
    unit: str = "1"

    def build(self) -> Parameter:
        """The parameter with its prior."""
        return Parameter(self.name, self.nominal, self.lower, self.upper, self.unit, self.std)


class BandTable(Table):
    """One [[band]], in Hz."""

    low: float
    high: float
    real: float = 1.0
    imag: float = 1.0

    def build(self) -> Band:
        """The band."""
        return Band(self.low, self.high, self.real, self.imag)


class PlacesTable(Table):
    """[places]: where a mechanism may act."""

    nodes: tuple[Text, ...] | None = None
    elements: tuple[tuple[Text, Text], ...] | None = None
    supports: tuple[Text, ...] | None = None


class StructureTable(Table):
    """[structure] of any kind."""

    def build(self, common: Common, folder: Path) -> Structure:
        """The structure that the table describes."""
        raise NotImplementedError


class Common(Table):
    """What every model.toml has besides its structure."""

    damping: DampingTable | None = None
    parameter: tuple[ParameterTable, ...] = ()
    band: tuple[BandTable, ...] = ()
    places: PlacesTable = PlacesTable()
    mechanism: tuple[dict[str, Any], ...] = ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in the file's order."""
        return tuple(p.build() for p in self.parameter)

    @property
    def damping_model(self) -> Damping:
        """The damping; none where the table is absent."""
        return Damping() if self.damping is None else self.damping.build()


def once(key: str, names: list[str]) -> None:
    """ConfigError if a name stands twice under `key`."""
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{key}: {name!r} stands there twice")
