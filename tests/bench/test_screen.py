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
    """A virtual screen of a number that the server found free; its environment."""
    reading, writing = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1600x1000x24"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, pass_fds=(writing,),
    )  # fmt: skip
    os.close(writing)
    with os.fdopen(reading) as told:  # comes when the server is ready; nothing if it stops before
        number = told.readline().strip()
    assert number, f"Xvfb stopped with {server.wait()}"
    yield {**os.environ, "DISPLAY": f":{number}", "QT_QPA_PLATFORM": "xcb", "PYTHONFAULTHANDLER": "1"}
    server.terminate()
    server.wait()


def _ok(words, env) -> bool:
    return subprocess.run(words, env=env, capture_output=True, timeout=20).returncode == 0


def _wait(condition, command, errors: Path, seconds=240.0):
    """Until `condition` holds; a failure shows what the command said and, if it still runs, where it stood."""
    until = time.monotonic() + seconds
    while not condition():
        ended = command.poll()
        if ended is None and time.monotonic() < until:
            time.sleep(0.1)
            continue
        if ended is None:
            command.send_signal(signal.SIGABRT)  # faulthandler writes the stack of every thread
            command.wait(20)
        what = "did not happen in time" if ended is None else f"can no longer happen: the command ended with {ended}"
        pytest.fail(f"it {what}\n{errors.read_text(errors='replace')[-6000:]}")


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
    errors = tmp_path / "errors.txt"
    with errors.open("w") as said:
        command = subprocess.Popen([sys.executable, *words], env=screen, stdout=said, stderr=said)

    def wait(condition):
        _wait(condition, command, errors)

    try:
        wait(lambda: _window(screen))
        wait(lambda: _hits(out) >= 3)
        window = _window(screen)
        assert _ok(["xdotool", "windowfocus", window], screen)
        wait(lambda: _ok(["xdotool", "key", "r"], screen) and _rejected(out))  # focus takes the server a moment
        shot = tmp_path / "window.png"
        assert _ok(["import", "-window", window, str(shot)], screen)
        assert shot.stat().st_size > 20_000  # an empty window takes a tenth of that
        assert _ok(["xdotool", "key", "Escape"], screen)
        assert command.wait(30) == 3
    finally:
        if command.poll() is None:
            command.kill()
            command.wait()
    with open_session(out) as session:
        run = session.runs[0]
        assert run.finished == "stopped by the user"
        assert "rejected by the user" in [h.reason for h in run.hits]
        assert run.gaps() == ()
    window = _window(screen)
    if window:  # it stays open for a last look
        subprocess.run(["xdotool", "windowclose", window], env=screen, capture_output=True, timeout=20)
