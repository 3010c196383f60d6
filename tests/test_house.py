"""The house itself: names, floors, documentation, and that nothing of a machine has crept in."""

import ast
import doctest
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("labnnum", "drivers", "sessions")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
FOREIGN = re.compile(r"/(w[o]rk|h[o]me|U[s]ers|r[o]ot)/\w|/t[m]p/\w|C:\\\\U[s]ers")
TEXTS = (".py", ".md", ".toml", ".j2", ".html", ".css", "")


def shown(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("package", PACKAGES)
def test_names_resolve_to_this_tree(package):
    module = importlib.import_module(package)
    assert Path(str(module.__file__)).resolve().parent == ROOT / package
    assert (ROOT / package / "py.typed").is_file()


def test_floors_hold():
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


def undocumented(path: Path) -> list[str]:
    """Public modules, classes, functions and methods of a source file that say nothing about themselves."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = [] if ast.get_docstring(tree) else ["the module"]

    def visit(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                if node.name.startswith("_") or any(_is_overload(d) for d in node.decorator_list):
                    continue
                if not ast.get_docstring(node):
                    found.append(prefix + node.name)
                if isinstance(node, ast.ClassDef):
                    visit(node.body, f"{prefix}{node.name}.")

    visit(tree.body, "")
    return found


def _is_overload(decorator: ast.expr) -> bool:
    name = decorator.attr if isinstance(decorator, ast.Attribute) else getattr(decorator, "id", "")
    return name in ("overload", "setter")


def test_every_public_name_is_documented():
    missing = {shown(path): names for path in SOURCES if (names := undocumented(path))}
    assert not missing


def texts() -> list[Path]:
    """Files that git holds (all files of the known folders where git is absent) and that are text."""
    try:
        listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True, timeout=60)
        files = [ROOT / name for name in listed.stdout.splitlines()]
    except (OSError, subprocess.CalledProcessError):
        folders = (*PACKAGES, "tests", "docs", "examples", "benchmarks")
        files = [path for folder in folders for path in (ROOT / folder).rglob("*")]
    return [path for path in files if path.is_file() and path.suffix in TEXTS]


def test_no_machine_paths_in_the_tree():
    found = {}
    for path in texts():
        lines = path.read_text(encoding="utf-8").splitlines()
        if hits := [n for n, line in enumerate(lines, 1) if FOREIGN.search(line)]:
            found[shown(path)] = hits
    assert not found


def with_examples() -> list[str]:
    """Modules of drivers and sessions whose docstrings hold examples; those of labnnum pytest runs by itself."""
    found = []
    for path in SOURCES:
        if ">>>" in path.read_text(encoding="utf-8") and path.relative_to(ROOT).parts[0] != "labnnum":
            parts = path.relative_to(ROOT).with_suffix("").parts
            found.append(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    return found


@pytest.mark.parametrize("name", with_examples())
def test_examples_in_docstrings(name):
    failed, tried = doctest.testmod(importlib.import_module(name))
    assert tried
    assert not failed


def test_the_map_names_every_room():
    """Each folder of code by its name: docs/architecture.md is the map."""
    told = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rooms = {path.parent for path in SOURCES if path.name == "__init__.py"} - {ROOT / p for p in PACKAGES}
    missing = [shown(room) for room in sorted(rooms) if f"{room.name}/" not in told]
    assert not missing


def test_every_page_is_linked():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    pages = [p.name for p in sorted((ROOT / "docs").glob("*.md")) if p.name != "index.md"]
    assert [name for name in pages if f"({name})" not in index] == []
    for page in (*(ROOT / "docs").glob("*.md"), ROOT / "README.md", ROOT / "CHANGELOG.md"):
        for link, heading in re.findall(r"\]\(([\w./-]+\.md)?(#[\w-]+)?\)", page.read_text(encoding="utf-8")):
            told = page.parent / link if link else page
            assert told.exists(), f"{shown(page)} links to {link}"
            assert not heading or heading[1:] in headings(told), f"{shown(page)} links to {link}{heading}"


def headings(page: Path) -> set[str]:
    """Names by which a page's headings are linked to: lower case, no punctuation, hyphens for spaces."""
    found = re.findall(r"^#+ +(.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", text).lower().replace(" ", "-") for text in found}


def test_every_mechanism_is_listed():
    """What it is, how it shows and what tells it apart, as the mechanism itself says."""
    from labnnum.mechanisms import CATALOGUE

    page = (ROOT / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    rows = ["| `" + " | ".join([m.id + "`", m.title, m.shows, m.told_apart]) + " |" for m in CATALOGUE]
    assert [row for row in rows if row not in page] == []


def test_the_commands_are_those_listed():
    from sessions.cli import COMMANDS, app

    assert [name for name, _ in COMMANDS] == [c.name for c in app.registered_commands]
    assert len({name for name, _ in COMMANDS}) == len(COMMANDS)


def test_the_version_is_the_package_s():
    from importlib.metadata import version

    from labnnum import __version__

    assert version("labnnum") == __version__
