"""A sound card that does not exist: PulseAudio's null sinks, which PortAudio takes for devices."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Self, final

from drivers.audio import portaudio
from labnnum.errors import DeviceNotFoundError

_MAPS = {
    1: "mono",
    2: "front-left,front-right",
    4: "front-left,front-right,rear-left,rear-right",
    6: "front-left,front-right,rear-left,rear-right,front-center,lfe",
    8: "front-left,front-right,rear-left,rear-right,front-center,lfe,side-left,side-right",
}
"""Channel maps as ALSA numbers them: streams have the same ones, so that nothing is remixed."""


def _libraries() -> list[Path]:
    """Where systems keep their shared libraries."""
    return [*Path("/usr/lib").glob("*-linux-*"), Path("/usr/lib"), Path("/usr/lib64")]


@final
class SoundServer:
    """A private sound server with null sinks: what is played into one can be recorded from its monitor.

    Parameters
    ----------
    sinks : sequence of str
        Their names.
    rate : int
        Frames per second.
    channels : int
        1, 2, 4, 6 or 8.

    Notes
    -----
    PulseAudio runs as an ordinary process with its own runtime folder and ends with the context. `environment` says
    which variables make a process play into one sink and record another's monitor. Samples pass unchanged: the sinks
    hold 32-bit floats, volumes stay at 1, and rates and channel maps are equal all along.
    """

    def __init__(self, sinks: tuple[str, ...] = ("drive", "answer"), rate: int = 48000, channels: int = 4) -> None:
        self.sinks, self.rate, self.channels = sinks, rate, channels
        self.folder = Path()
        self._process: subprocess.Popen[bytes] | None = None

    @staticmethod
    def missing() -> str:
        """What this computer lacks for it; "" if nothing."""
        if shutil.which("pulseaudio") is None:
            return "pulseaudio is not installed"
        if not any((p / "alsa-lib" / "libasound_module_pcm_pulse.so").exists() for p in _libraries()):
            return "ALSA's pulse plugin (libasound2-plugins) is not installed"
        try:
            portaudio()
        except DeviceNotFoundError as error:
            return str(error)
        return ""

    def environment(self, play: str, record: str) -> dict[str, str]:
        """Variables of a process that plays into the sink `play` and records what goes into the sink `record`."""
        return {
            "XDG_RUNTIME_DIR": str(self.folder),
            "PULSE_RUNTIME_PATH": str(self.folder / "pulse"),
            "PULSE_SERVER": f"unix:{self.folder / 'pulse' / 'native'}",
            "PULSE_SINK": play,
            "PULSE_SOURCE": f"{record}.monitor",
        }

    def __enter__(self) -> Self:
        lacking = self.missing()
        if lacking:
            raise DeviceNotFoundError(f"no sound server can be started: {lacking}")
        self.folder = Path(tempfile.mkdtemp(prefix="labnnum-sound-"))
        self._configure()
        with (self.folder / "log").open("wb") as log:
            self._process = subprocess.Popen(
                ["pulseaudio", "-n", "-F", str(self.folder / "script.pa"), "--exit-idle-time=-1", "--daemonize=no"],
                env={**os.environ, **self._own_environment()},
                stdout=subprocess.DEVNULL,
                stderr=log,
            )
        self._wait()
        return self

    def _own_environment(self) -> dict[str, str]:
        here = str(self.folder)
        return {
            **{"XDG_RUNTIME_DIR": here, "XDG_CONFIG_HOME": here, "HOME": here},
            "PULSE_RUNTIME_PATH": f"{here}/pulse",
        }

    def _configure(self) -> None:
        (self.folder / "pulse").mkdir(mode=0o700)
        (self.folder / "pulse" / "daemon.conf").write_text(
            "enable-remixing = no\nflat-volumes = no\nrealtime-scheduling = no\nresample-method = trivial\n"
        )
        shape = (
            f"rate={self.rate} channels={self.channels} format=float32le channel_map={_MAPS[self.channels]} norewinds=1"
        )
        sinks = [f"load-module module-null-sink sink_name={name} {shape}" for name in self.sinks]
        socket = f"load-module module-native-protocol-unix socket={self.folder / 'pulse' / 'native'} auth-anonymous=1"
        (self.folder / "script.pa").write_text("\n".join([*sinks, socket, ""]))

    def _wait(self) -> None:
        """Until its socket is there."""
        assert self._process is not None
        until = time.monotonic() + 10.0
        while not (self.folder / "pulse" / "native").exists():
            if self._process.poll() is not None or time.monotonic() > until:
                said = (self.folder / "log").read_text(errors="replace").strip().splitlines()[-1:]
                self.stop()
                raise DeviceNotFoundError(f"the sound server did not start: {''.join(said) or 'it said nothing'}")
            time.sleep(0.02)

    def stop(self) -> None:
        """End the server, as a device that is unplugged."""
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._process = None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        shutil.rmtree(self.folder, ignore_errors=True)
