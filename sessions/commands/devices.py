"""labnnum devices: what is plugged into this computer."""

from __future__ import annotations

from typing import Annotated, Any

import typer


def devices(as_json: Annotated[bool, typer.Option("--json", help="Print the lists as JSON.")] = False) -> None:
    """List audio devices and serial ports, by the names and numbers that rig.toml takes.

    An audio device goes into `device.name` (its number, its name, or a part of the name that no other has), a serial
    port into `generator.port`.

    For example:

        labnnum devices
    """
    import json

    from drivers.generators import OPENERS
    from drivers.transport import ports

    found, lacking = _audio()
    told = {**found, "serial_ports": list(ports()), "generators": ["audio", *OPENERS]}
    if as_json:
        typer.echo(json.dumps({**told, "portaudio": lacking or "found"}))
        return
    typer.echo(_text(told, lacking))


def _audio() -> tuple[dict[str, Any], str]:
    """Devices with inputs and with outputs, and why there are none if PortAudio is missing."""
    from drivers import audio
    from labnnum.errors import DeviceNotFoundError

    keys = ("number", "name", "channels", "rate")
    try:
        inputs = [dict(zip(keys, one, strict=True)) for one in audio.devices("input")]
        outputs = [dict(zip(keys, one, strict=True)) for one in audio.devices("output")]
    except DeviceNotFoundError as error:
        return {"inputs": [], "outputs": []}, str(error)
    return {"inputs": inputs, "outputs": outputs}, ""


def _text(told: dict[str, Any], lacking: str) -> str:
    from sessions.commands.printing import table

    lines = [f"audio: {lacking}"] if lacking else []
    for key in ("inputs", "outputs"):
        rows = [[str(d["number"]), d["name"], str(d["channels"]), f"{d['rate']:g}"] for d in told[key]]
        if rows:
            lines += [f"audio {key}:", table(["number", "name", key, "usual rate"], rows)]
        elif not lacking:
            lines.append(f"audio {key}: none")
    lines.append(f"serial ports: {', '.join(told['serial_ports']) or 'none'}")
    lines.append(f"kinds of generator: {', '.join(told['generators'])}")
    return "\n".join(lines)
