"""Function generators, one instrument a file; `OPENERS` lists them by the kind that rig.toml names."""

from collections.abc import Callable

from drivers.generators.base import Generator, Limits, Settings
from drivers.generators.feeltech import open_feeltech
from drivers.generators.junce import open_junce
from drivers.generators.scpi import open_scpi

OPENERS: dict[str, Callable[..., Generator]] = {
    "scpi": open_scpi,
    "feeltech": open_feeltech,
    "junce": open_junce,
}
"""Kind -> opener(port, channel, max_volts)."""

__all__ = ["OPENERS", "Generator", "Limits", "Settings"]
