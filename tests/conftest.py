"""Fixtures shared by all tests."""

import os
from collections.abc import Generator
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


@pytest.hookimpl(wrapper=True)
def pytest_collect_file() -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """No file of tests is searched for examples in docstrings as well: that imports each of them twice."""
    return [c for c in (yield) if type(c).__name__ != "DoctestModule"]


COMPILING = ("tests/test_prove", "tests/test_nonlinear", "tests/updating", "tests/test_demo", "tests/test_reproduce")
"""Beginnings of the paths of tests that need what is compiled, beside those of the diagnosis."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first, and on another worker those that need nothing compiled: two that begin with the same function
    compile it twice, and of long ones that come last one worker would do the last alone.
    """

    def turn(item: pytest.Item) -> int:
        path = item.path.relative_to(ROOT).as_posix()
        return 0 if path.startswith("tests/diagnosis") else 2 if path.startswith(COMPILING) else 1

    items.sort(key=turn)


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of the real recordings; skips where it is absent."""
    if not RECORDINGS.is_dir():
        pytest.skip("the real recordings are not beside this checkout")
    return RECORDINGS
