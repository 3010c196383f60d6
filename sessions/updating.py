"""From a stored FRF to a stored estimate: what `labnnum update`, the demo and the window call."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.bands import Band
from labnnum.errors import ConfigError, FileError
from labnnum.frf import Frf
from labnnum.parameters import Estimate
from labnnum.structures.base import Structure
from labnnum.updating.peers import PEERS
from labnnum.updating.refine import refine, seen_frf
from labnnum.updating.updater import Updater
from sessions.estimates import StoredEstimate, store_estimate
from sessions.exchange import load_frf
from sessions.model import read_model
from sessions.store import open_session
from sessions.updaters import load_updater

METHODS = ("refined", "network", "least-squares", *PEERS)
FLOORED = ("refined", "least-squares")
"""Methods that grant the model an error of its own."""


@dataclass(frozen=True, eq=False)
class Update:
    """An estimate with what made it.

    Parameters
    ----------
    estimate : Estimate
    structure : Structure
    bands : tuple of Band
    frf : Frf
    frf_name : str
        Path of the FRF in its session, or of the file.
    settings : mapping
        Method, updater and model, for the session; "floor", the share of |H| that the model was granted as its error.
    """

    estimate: Estimate
    structure: Structure
    bands: tuple[Band, ...]
    frf: Frf
    frf_name: str
    settings: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Measured:
    """An FRF and where it stands."""

    frf: Frf
    name: str


def choose_frf(path: Path, name: str = "", channels: Path | None = None) -> Measured:
    """The FRF of a session (the last, or the one called `name`) or of a file of another program.

    Raises
    ------
    FileError
        If there is none, or none of that name; those that exist are listed.
    """
    if path.suffix.lower() not in (".h5", ".hdf5"):
        return Measured(load_frf(path, channels), str(path))
    with open_session(path) as session:
        found = session.frfs()
    if not found:
        raise FileError(f"{path}: holds no FRF yet; estimate one with 'labnnum frf {path}'")
    names = [str(f.settings.get("stored", "")) for f in found]
    if not name:
        return Measured(found[-1], names[-1])
    for frf, stored in zip(found, names, strict=True):
        if stored == name or stored.rsplit("/", 1)[-1] == name:
            return Measured(frf, stored)
    raise FileError(f"{path}: has no FRF {name!r}; there are {', '.join(names)}")


def run_update(
    measured: Measured,
    updater: Path | None,
    model: Path | None,
    method: str = "refined",
    *,
    prior: bool = False,
    floor: float | None = None,
) -> Update:
    """Estimate the parameters by the method that is named.

    Raises
    ------
    ConfigError
        If the method is unknown, or lacks the updater or model that it needs.
    """
    if method not in METHODS:
        raise ConfigError(f"--method {method!r}: expected one of {', '.join(METHODS)}")
    if updater is None and model is None:
        raise ConfigError("give --updater, or --model to fit from nominal values")
    read = None if model is None else read_model(model)
    told: dict[str, Any] = {"method": method, "updater": "" if updater is None else updater.name}
    told |= {"model": "" if model is None else model.name, "prior": prior}
    told["floor"] = floor or 0.0 if method in FLOORED else 0.0
    if updater is None:
        assert read is not None
        if method == "network":
            raise ConfigError("--method network needs --updater; train one with 'labnnum train'")
        estimate = _from_nominal(read.structure, read.bands, measured.frf, method, prior, floor)
        return Update(estimate, read.structure, read.bands, measured.frf, measured.name, told)
    trained = load_updater(updater, None if read is None else read.structure)
    estimate = _by_updater(trained, measured.frf, method, prior, floor)
    return Update(estimate, trained.structure, trained.bands, measured.frf, measured.name, told)


def _from_nominal(
    structure: Structure, bands: tuple[Band, ...], frf: Frf, method: str, prior: bool, floor: float | None
) -> Estimate:
    if method in PEERS:
        return PEERS[method](structure, frf, bands=bands)
    return refine(structure, frf, bands=bands, prior=prior, floor=floor)


def _by_updater(trained: Updater, frf: Frf, method: str, prior: bool, floor: float | None) -> Estimate:
    if method == "network":
        return trained.estimate(frf, refined=False)
    if method == "refined":
        return trained.estimate(frf, prior=prior, floor=floor)
    return _from_nominal(trained.structure, trained.bands, frf, method, prior, floor)


def store(path: Path, done: Update, truth: Mapping[str, float] | None = None) -> str:
    """Put the estimate into the session beside the FRF, with the model's FRF before and after; its path there.

    `truth`, parameter name -> value, is what only a simulated bench knows.
    """
    lines = plotted(done.frf, done.bands)
    cut = done.frf.at(lines)
    before, after = (_seen(done, theta, cut) for theta in (done.structure.nominal, done.estimate.value))
    stored = StoredEstimate(
        estimate=done.estimate,
        frf=done.frf_name,
        frequency=cut.frequency,
        before=before,
        after=after,
        bands=tuple((b.low, b.high) for b in done.bands),
        truth=truth or {},
        settings=done.settings,
    )
    with open_session(path, "a") as session:
        return store_estimate(session, stored, name=done.settings["method"])


def _seen(done: Update, theta: NDArray, cut: Frf) -> NDArray[np.complex128]:
    return seen_frf(done.structure, theta, cut)


def plotted(frf: Frf, bands: tuple[Band, ...]) -> NDArray[np.bool_]:
    """Lines from half the lowest band edge to a quarter beyond the highest, 0 Hz left out."""
    if not bands:
        return frf.frequency > 0
    low, high = min(b.low for b in bands), max(b.high for b in bands)
    return (frf.frequency >= low / 2) & (frf.frequency <= high * 1.25) & (frf.frequency > 0)
