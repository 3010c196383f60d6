"""Several computations at a time: results, and no process left behind."""

import os
import subprocess
import sys
import time

import pytest

from sessions.prove.jobs import each

SCRIPT = """
import os, time
from sessions.prove.jobs import each

def stay(number):
    os.write(1, f"{os.getpid()}\\n".encode())  # in one piece: two processes write to this pipe
    time.sleep(60)
    return number

if __name__ == "__main__":
    list(each(stay, [1, 2], jobs=2))
"""


def test_results_of_two_processes_are_those_of_one():
    assert sorted(each(abs, [-3, 2, -1], jobs=2)) == sorted(each(abs, [-3, 2, -1]))


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="looks processes up in /proc")
def test_workers_end_with_the_process_that_started_them(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as main:
        assert main.stdout is not None
        workers = [int(main.stdout.readline()) for _ in range(2)]
        main.kill()
    deadline = time.monotonic() + 20
    while any(_lives(pid) for pid in workers) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(_lives(pid) for pid in workers)


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat", encoding="ascii") as f:  # a zombie that nobody has waited for is gone
        return f.read().rsplit(")", 1)[1].split()[0] != "Z"
