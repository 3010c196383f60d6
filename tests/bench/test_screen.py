"""The live window as a real process on a real (virtual) screen, with real keys, during a hammer session."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sessions.store import open_session

from .rigs import live_rig

NEEDED = ("Xvfb", "import", "xdotool")
MISSING = [tool for tool in NEEDED if shutil.which(tool) is None]
pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)} (apt: xvfb, imagemagick, xdotool)"),
    pytest.mark.usefixtures("qtbot"),
]

CHANGES = (
    ("rate = 4096", "rate = 2048"),
    ("buffer = 0.5\n", ""),
    ('["1:x"]\nhits = 3', '["1:x", "1:-x"]\nhits = 40'),
    ("duration = 0.3", "duration = 0.4"),
    ("interval = 0.45", "interval = 0.6\ndouble = 0.3"),
)


@pytest.fixture
def screen():
    """A virtual screen; its environment."""
    number = 90 + os.getpid() % 900
    server = subprocess.Popen(
        ["Xvfb", f":{number}", "-screen", "0", "1600x1000x24"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    env = {**os.environ, "DISPLAY": f":{number}", "QT_QPA_PLATFORM": "xcb"}
    _wait(lambda: _ok(["xdotool", "getdisplaygeometry"], env))
    yield env
    server.terminate()
    server.wait()


def _ok(words, env) -> bool:
    return subprocess.run(words, env=env, capture_output=True, timeout=20).returncode == 0


def _wait(condition, seconds=120.0):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "it did not happen in time"
        time.sleep(0.1)


def _window(env) -> str:
    found = subprocess.run(
        ["xdotool", "search", "--name", "^labnnum$"], env=env, capture_output=True, text=True, timeout=20
    )
    return found.stdout.split()[-1] if found.stdout.split() else ""


def _hits(path: Path) -> int:
    if not path.exists():
        return 0
    with open_session(path) as session:
        return len(session.runs[0].hits) if session.runs else 0


def _rejected(path: Path) -> bool:
    with open_session(path) as session:
        return "rejected by the user" in [h.reason for h in session.runs[0].hits]


def test_a_session_on_a_screen(tmp_path, screen):
    live_rig(tmp_path, *CHANGES, stiffness=1e5, damping=40.0)
    out = tmp_path / "out.h5"
    probe = subprocess.run(
        [sys.executable, "-c", "from PySide6.QtWidgets import QApplication; QApplication([])"],
        env=screen, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    if probe.returncode:
        pytest.skip(f"Qt cannot draw on this screen: {probe.stderr.strip().splitlines()[-1:]}")
    words = ["-m", "sessions.cli", "measure", str(tmp_path / "rig.toml"), "-o", str(out), "--live"]
    command = subprocess.Popen([sys.executable, *words], env=screen, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        _wait(lambda: _window(screen))
        _wait(lambda: _hits(out) >= 3)
        window = _window(screen)
        assert _ok(["xdotool", "windowfocus", window], screen)
        _wait(lambda: _ok(["xdotool", "key", "r"], screen) and _rejected(out))  # focus takes the server a moment
        shot = tmp_path / "window.png"
        assert _ok(["import", "-window", window, str(shot)], screen)
        assert shot.stat().st_size > 20_000  # an empty window takes a tenth of that
        assert _ok(["xdotool", "key", "Escape"], screen)
        assert command.wait(30) == 3
    finally:
        if command.poll() is None:
            command.send_signal(signal.SIGKILL)
        command.communicate()
    with open_session(out) as session:
        run = session.runs[0]
        assert run.finished == "stopped by the user"
        assert "rejected by the user" in [h.reason for h in run.hits]
        assert run.gaps() == ()
    window = _window(screen)
    if window:  # it stays open for a last look
        subprocess.run(["xdotool", "windowclose", window], env=screen, capture_output=True, timeout=20)
