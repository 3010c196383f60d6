"""Fixtures shared by all tests."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
RECORDINGS = ROOT.parent / "shared" / "recordings"

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_library, "1")  # as the command line does: threads of small matrices wait for each other


def qt_failure() -> str:
    """Why Qt cannot be loaded here (a bare Linux lacks libEGL and kin); empty if it can."""
    try:
        import PySide6.QtTest
        import PySide6.QtWidgets  # noqa: F401
    except ImportError as error:
        return str(error)
    return ""


# pytest-qt stops the whole run where Qt cannot load, so it is switched off in pyproject.toml and loaded here.
NO_QT = qt_failure()
pytest_plugins = [] if NO_QT else ["pytestqt.plugin"]

if NO_QT:

    @pytest.fixture
    def qtbot() -> None:
        """Skips: tests of the window need Qt."""
        pytest.skip(f"Qt cannot be loaded: {NO_QT}")


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of the real recordings; skips where it is absent."""
    if not RECORDINGS.is_dir():
        pytest.skip("the real recordings are not beside this checkout")
    return RECORDINGS
