"""labnnum info: what a session, or a file of another program, holds."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from labnnum.frf import Frf
    from sessions.runs import Run
    from sessions.store import Session


def info(
    file: Annotated[Path, typer.Argument(help="A session, or a file to import.", show_default=False)],
    rig: Annotated[bool, typer.Option("--rig", help="Print the rig.toml that the session keeps.")] = False,
    model: Annotated[bool, typer.Option("--model", help="Print the model.toml that it keeps.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
) -> None:
    """Show what a file holds: a session's runs, channels, hits and results, an updater, arrays of other files.

    Of a session it lists every run with its channels, how long it is, its hits (accepted of all), gaps, overloads
    and how it ended, and every result that was computed from it. A session that is just being recorded can be
    looked at too.

    For example:

        labnnum info beam.h5

        labnnum info beam.h5 --rig > rig.toml

        labnnum info frf.uff --json
    """
    import json

    from sessions.commands.printing import finite
    from sessions.exchange import SESSION_SUFFIXES
    from sessions.store import open_session
    from sessions.updaters import is_updater

    if rig or model:
        typer.echo(_kept(file, "rig" if rig else "model"), nl=False)
        return
    if is_updater(file):
        said = describe_updater(file)
        text = "" if as_json else _updater_text(said)
    elif file.suffix.lower() in SESSION_SUFFIXES or not file.exists():
        with open_session(file) as session:
            said = describe_session(session)
            text = "" if as_json else _session_text(said)
    else:
        said = describe_file(file)
        text = "" if as_json else _file_text(said)
    typer.echo(json.dumps(finite(said)) if as_json else text)


def _kept(file: Path, what: str) -> str:
    """The rig.toml or model.toml that a session keeps."""
    from labnnum.errors import FileError
    from sessions.store import open_session

    with open_session(file) as session:
        text = session.rig_text if what == "rig" else session.model_text
    if not text:
        raise FileError(f"{file}: keeps no {what}.toml")
    return text


def describe_updater(path: Path) -> dict[str, Any]:
    """What an updater is for, as `--json` prints it."""
    from sessions.updaters import load_updater

    found = load_updater(path)
    return {
        "file": str(path),
        "outputs": [c.name for c in found.outputs],
        "inputs": [c.name for c in found.inputs],
        "bands": [[b.low, b.high] for b in found.bands],
        "lines": int(found.frequency.size),
        "parameters": [
            {"name": p.name, "unit": p.unit, "lower": p.lower, "upper": p.upper, "e_avg": float(a), "e_max": float(b)}
            for p, a, b in zip(found.structure.parameters, *found.validation, strict=True)
        ],
        "settings": found.settings,
    }


def _updater_text(said: dict[str, Any]) -> str:
    from sessions.commands.printing import table

    bands = ", ".join(f"{low:g} to {high:g}" for low, high in said["bands"])
    rows = [
        [p["name"], p["unit"], *(f"{p[k]:.4g}" for k in ("lower", "upper", "e_avg", "e_max"))]
        for p in said["parameters"]
    ]
    return "\n".join(
        [
            f"{said['file']}: updater of {said['settings'].get('samples', '?')} sets, {said['lines']} lines",
            f"from {', '.join(said['inputs'])} to {', '.join(said['outputs'])}, in {bands} Hz",
            table(["parameter", "unit", "lower", "upper", "mean error %", "largest %"], rows),
        ]
    )


def describe_session(session: Session) -> dict[str, Any]:
    """What a session holds, as `--json` prints it."""
    return {
        "file": str(session.path),
        "created": _time(session.created),
        "code_version": session.code_version,
        "notice": session.notice,
        "rig": bool(session.rig_text),
        "model": bool(session.model_text),
        "runs": [_run(run) for run in session.runs],
        "frfs": [_frf(frf) for frf in session.frfs()],
        "results": [
            {"stored": f"results/{r.kind}/{r.number:04d}", "name": r.name, "created": _time(r.created)}
            for r in session.results()
        ],
    }


def _run(run: Run) -> dict[str, Any]:
    hits, blocks = run.hits, run.blocks
    return {
        "index": run.index,
        "label": run.label.split(": ", 1)[1],
        "rate": run.rate,
        "samples": run.n_samples,
        "duration": run.n_samples / run.rate,
        "level": run.level,
        "period": run.period,
        "drop_periods": run.drop_periods,
        "created": _time(run.created),
        "finished": run.finished,
        "blocks": int(blocks.size),
        "gaps": len(run.gaps()),
        "lost": int(blocks["lost"].sum()),
        "overflows": int(blocks["overflow"].sum()),
        "hits": {"accepted": sum(h.accepted for h in hits), "all": len(hits)},
        "channels": [
            {
                "name": c.channel.name,
                "quantity": c.channel.quantity,
                "unit": c.channel.unit,
                "role": c.channel.role,
                "dof": c.channel.dof,
                "direction": c.channel.direction,
                "raw_unit": c.raw_unit,
                "sensitivity": c.channel.sensitivity,
                "overloads": overloads,
            }
            for c, overloads in zip(run.stored, run.overload_counts(), strict=True)
        ],
    }


def _frf(frf: Frf) -> dict[str, Any]:
    return {
        "stored": frf.settings["stored"],
        "name": frf.settings["name"],
        "estimator": frf.estimator,
        "n_averages": frf.n_averages,
        "lines": int(frf.frequency.size),
        "low": float(frf.frequency[0]),
        "high": float(frf.frequency[-1]),
        "outputs": [c.name for c in frf.outputs],
        "inputs": [c.name for c in frf.inputs],
        "settings": {k: frf.settings[k] for k in ("window", "n_segment", "overlap", "runs") if k in frf.settings},
    }


def _time(stamp: float) -> str:
    return datetime.fromtimestamp(stamp, UTC).isoformat(timespec="seconds")


def describe_file(path: Path) -> dict[str, Any]:
    """What a file of another program holds, as `--json` prints it."""
    from sessions.exchange import format_of, uff

    kind = format_of(path)
    if kind.name == "universal file":
        functions = uff.read_functions(path)
        return {
            "file": str(path),
            "format": kind.name,
            "datasets": uff.dataset_kinds(path),
            "functions": [_function(f) for f in functions],
            "nodes": len(uff.nodes(path)),
        }
    arrays = kind.read(path)
    return {
        "file": str(path),
        "format": kind.name,
        "rate": arrays.rate,
        "arrays": {k: {"shape": list(a.shape), "type": str(a.dtype)} for k, a in arrays.arrays.items()},
        "carries_channels": bool(arrays.channels),
    }


def _function(function: Any) -> dict[str, Any]:
    from sessions.exchange.uff import KINDS

    return {
        "name": function.title,
        "kind": KINDS.get(function.kind, f"kind {function.kind}"),
        "unit": function.unit,
        "values": int(function.data.size),
        "first": float(function.x[0]) if function.x.size else None,
        "last": float(function.x[-1]) if function.x.size else None,
        "abscissa_unit": function.units[0],
        "even": function.spacing is not None,
    }


def _session_text(said: dict[str, Any]) -> str:
    kept = [name for name in ("rig", "model") if said[name]]
    lines = [
        f"{said['file']}: session of {said['created']}, labnnum {said['code_version']}"
        + (f", with {' and '.join(kept)}.toml" if kept else "")
    ]
    lines += [said["notice"]] if said["notice"] else []
    for run in said["runs"]:
        lines += ["", *_run_lines(run)]
    if said["frfs"] or said["results"]:
        lines += ["", "results"]
    for frf in said["frfs"]:
        averages = "" if frf["n_averages"] != frf["n_averages"] else f", {frf['n_averages']:.4g} averages"
        lines.append(
            f"  {frf['stored']}  {frf['estimator']} of {frf['name']}: {len(frf['outputs'])} x {len(frf['inputs'])},"
            f" {frf['lines']} lines {frf['low']:.6g} to {frf['high']:.6g} Hz{averages}"
        )
    lines += [f"  {one['stored']}  {one['name']}" for one in said["results"]]
    if not said["runs"] and not said["frfs"]:
        lines.append("nothing is recorded yet")
    return "\n".join(lines)


def _run_lines(run: dict[str, Any]) -> list[str]:
    from sessions.commands.printing import table

    told = [f"{run['samples']} samples at {run['rate']:.8g} Hz ({run['duration']:.6g} s)"]
    told += [f"level {run['level']:g}"] if run["level"] == run["level"] else []
    told += [f"period {run['period']}, first {run['drop_periods']} dropped"] if run["period"] else []
    told += [f"{run['hits']['accepted']} of {run['hits']['all']} hits accepted"] if run["hits"]["all"] else []
    told += [f"{run['gaps']} gaps"] if run["gaps"] else []
    told += [f"{run['overflows']} overflows"] if run["overflows"] else []
    told.append(run["finished"] or "not finished")
    head = ["channel", "quantity", "unit", "role", "place", "stored as", "overloads"]
    rows = [
        [
            *(c["name"], c["quantity"], c["unit"], c["role"]),
            *(("-" if c["direction"].startswith("-") else "") + c["dof"], c["raw_unit"]),
            str(c["overloads"]) if c["overloads"] else "",
        ]
        for c in run["channels"]
    ]
    body = [f"  {line}" for line in table(head, rows).splitlines()]
    return [f"run {run['index']}  {run['label']}: {', '.join(told)}", *body]


def _file_text(said: dict[str, Any]) -> str:
    lines = [f"{said['file']}: {said['format'].removesuffix(' file')} file"]
    if "functions" in said:
        lines += [f"  datasets {', '.join(str(d) for d in said['datasets'])}"]
        for f in said["functions"]:
            lines.append(
                f"  {f['kind']} {f['name']!r} in {f['unit'] or 'no unit'}: {f['values']} values,"
                f" {f['first']:g} to {f['last']:g} {f['abscissa_unit']}{'' if f['even'] else ', uneven'}"
            )
        lines += [f"  {said['nodes']} nodes"] if said["nodes"] else []
    else:
        lines += [f"  {said['rate']:g} Hz"] if said["rate"] == said["rate"] else []
        lines += [f"  {name}: {a['type']} {a['shape']}" for name, a in said["arrays"].items()]
        if said["carries_channels"]:
            lines.append("  it carries its own channels.toml")
    return "\n".join(lines)
