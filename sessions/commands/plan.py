"""labnnum plan: how to measure a structure, proposed from its model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def plan(
    model: Annotated[Path, typer.Argument(help="model.toml: the structure as expected.", show_default=False)],
    excitation: Annotated[str, typer.Option(help="multisine, random, hammer or stepped-sine.")] = "multisine",
    purpose: Annotated[str, typer.Option("--for", help="update, or diagnosis (levels, detection lines).")] = "update",
    low: Annotated[float | None, typer.Option(help="Lower end of the band, Hz.")] = None,
    high: Annotated[float | None, typer.Option(help="Upper end of the band, Hz.")] = None,
    rate: Annotated[float | None, typer.Option(help="The device's samples per second, if settled.")] = None,
    damping: Annotated[float, typer.Option(help="Ratio for modes that the model leaves undamped.")] = 0.005,
    error: Annotated[float, typer.Option(help="Random error of |H| to reach.")] = 0.02,
    coherence: Annotated[float, typer.Option(help="... where the coherence is this.")] = 0.95,
    top: Annotated[float | None, typer.Option(help="Highest level, RMS in N or m/s^2; a hammer's peak in N.")] = None,
    limit: Annotated[float | None, typer.Option(help="Peak response in m/s^2 that your sensors take.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the proposal as JSON.")] = False,
) -> None:
    """Propose how to measure: rate, lines, durations, levels and tip, each with its reason.

    The output is text for your rig.toml: the tables that it holds replace yours.

    `labnnum plan model.toml --for diagnosis --top 5 --limit 500`
    """
    import json

    from labnnum.errors import ConfigError
    from sessions.model import read_model
    from sessions.plan import LINES, Wishes, propose

    kind = excitation.replace("-", " ")
    if kind not in LINES:
        raise ConfigError(
            f"--excitation {excitation!r}: expected one of {', '.join(k.replace(' ', '-') for k in LINES)}"
        )
    if purpose not in ("update", "diagnosis"):
        raise ConfigError(f"--for {purpose!r}: expected update or diagnosis")
    for name, value in (
        ("--damping", damping),
        ("--error", error),
        ("--rate", rate),
        ("--top", top),
        ("--limit", limit),
    ):
        if value is not None and not value > 0:
            raise ConfigError(f"{name} {value:g}: must be positive")
    if not 0 < coherence < 1:
        raise ConfigError(f"--coherence {coherence:g}: must lie between 0 and 1")
    read = read_model(model)
    highest = top if top is not None else (100.0 if kind == "hammer" else 1.0)
    wishes = Wishes(
        kind, purpose, low, high, rate, damping, error, coherence, highest, limit  # ty: ignore[invalid-argument-type]
    )  # fmt: skip
    proposal = propose(read.structure, read.structure.nominal, read.bands, wishes)
    if as_json:
        told = {"tables": proposal.tables, "reasons": proposal.reasons, "seconds": proposal.seconds}
        typer.echo(json.dumps({**told, "modes": [{"frequency": f, "damping": z} for f, z in proposal.modes]}))
        return
    typer.echo(proposal.toml.rstrip())
    for f, z in proposal.modes:
        typer.echo(f"mode at {f:.4g} Hz, damping {100 * z:.3g} %", err=True)
    typer.echo(f"measuring takes {proposal.seconds:.0f} s" + (" a point" if kind == "hammer" else ""), err=True)
