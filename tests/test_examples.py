"""The examples run, and print what they say they print."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def promised(path: Path) -> str:
    """What stands after "# prints:" at the end of an example."""
    _, _, tail = path.read_text(encoding="utf-8").partition("\n# prints:\n")
    return "".join(f"{line.removeprefix('# ')}\n" for line in tail.splitlines())


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_it_prints_what_it_promises(path, tmp_path):
    environment = {**os.environ, "PYTHONWARNINGS": "error::RuntimeWarning", "PYTHONIOENCODING": "utf-8"}
    done = subprocess.run(
        [sys.executable, str(path)], cwd=tmp_path, capture_output=True, encoding="utf-8", env=environment, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == promised(path)
    assert not list(tmp_path.iterdir())
