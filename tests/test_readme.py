"""What README and the index of the documents say is so."""

import re
import runpy
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sessions.cli import COMMANDS, app
from sessions.demo import run_demo

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(heading: str, language: str = "") -> str:
    """The code under a heading: fenced in a language, or indented."""
    section = README.split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]
    if language:
        return section.split(f"```{language}\n", 1)[1].split("```", 1)[0]
    return "".join(f"{line[4:]}\n" for line in section.splitlines() if line.startswith("    "))


def test_every_command_has_its_row():
    listed = re.findall(r"^\| `([a-z-]+)` \|", README, re.MULTILINE)
    assert sorted(listed) == sorted(name for name, _ in COMMANDS)


def test_the_test_command_is_what_ci_runs():
    _, command = re.findall(r"^    (python3 -m venv .+)$", README, re.MULTILINE)
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for part in command.split(" && "):
        assert part in ci


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))], ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    prose = re.sub(r"^    .*$|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", prose):
        if "://" not in target:
            assert (page.parent / target).exists(), target


def test_the_index_lists_every_page():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    pages = {p.name for p in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert pages == set(re.findall(r"\]\((\w[\w-]*\.md)\)", index))


def test_the_walk_in_python(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run_demo(Path("labnnum-demo"), seed=0, samples=100)
    Path("walk.py").write_text(block("The same in Python", "python"), encoding="utf-8")
    runpy.run_path("walk.py")
    printed = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in printed] == ["m_acc", "I_acc", "alpha", "beta"]


def test_the_walk_on_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line in block("The walk, on the command line").splitlines():
        words = shlex.split(line, comments=True)
        assert words[0] == "labnnum"
        quick = ["--samples", "100"] if words[1] == "train" else []
        done = CliRunner().invoke(app, [*words[1:], *quick])
        assert done.exit_code == 0, f"{line}\n{done.output}\n{done.exception}"
    assert (tmp_path / "first" / "run.html").is_file()
