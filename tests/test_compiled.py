"""Machine code on disk is not used once a file that it draws on has changed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CALLED = "from numba import njit\n\n\n@njit(cache=True)\ndef twice(x):\n    return {factor} * x\n"
CALLING = """from numba import njit
from called import twice
{imported}

@njit(cache=True)
def between(x):
    return twice(x)


{decorated}@njit(cache=True)
def more(x):
    return between(x) + 1


print(more(3))
"""


@pytest.mark.parametrize("kept", [True, False])
def test_a_change_in_what_is_called_is_seen(tmp_path: Path, kept: bool):
    marked = {"imported": "from labnnum.compiled import up_to_date\n", "decorated": "@up_to_date\n"}
    (tmp_path / "calling.py").write_text(CALLING.format(**({"imported": "", "decorated": ""} if kept else marked)))

    def made(factor: int, since: int) -> int:
        called = tmp_path / "called.py"
        called.write_text(CALLED.format(factor=factor))
        os.utime(called, ns=(called.stat().st_mtime_ns + since,) * 2)
        run = subprocess.run([sys.executable, "calling.py"], cwd=tmp_path, capture_output=True, text=True, check=True)
        return int(run.stdout)

    assert made(2, -(10**9)) == 7
    changed = made(5, 10**9)
    assert changed == (7 if kept else 16)  # what numba alone does, and why this is needed


def test_what_is_not_compiled_is_left_as_it_is():
    from labnnum.compiled import up_to_date

    assert up_to_date(len) is len
