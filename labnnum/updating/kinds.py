"""Every kind of features by its name, for stored updaters and the command line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labnnum.bands import Band, check_bands
from labnnum.errors import ConfigError
from labnnum.updating.features import BandIntegrals, Features, LogBands, SphereBands
from labnnum.updating.scores import ScoreBands

FEATURES: tuple[type[Features], ...] = (BandIntegrals, LogBands, SphereBands, ScoreBands)
"""Every kind of features that a stored updater may name."""


def make_features(kind: str, bands: Sequence[Band], **settings: Any) -> Features:
    """Features of the kind that is named ("integrals", "log", "sphere" or "score"); ConfigError for another name."""
    for cls in FEATURES:
        if cls.kind == kind:
            if "scale" in settings:
                settings["scale"] = tuple(settings["scale"])
            return cls(check_bands(bands), **settings)  # ty: ignore[too-many-positional-arguments]
    raise ConfigError(f"features {kind!r} are not one of {', '.join(c.kind for c in FEATURES)}")
