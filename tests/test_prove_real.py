"""`labnnum prove real`: what it prints, writes, leaves out and refuses; the long recordings are run by hand."""

import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.diagnosis.nonlinear.joined import Predicted
from labnnum.errors import ConfigError, FileError
from labnnum.recording import Channel
from sessions.cli import app
from sessions.prove import real
from sessions.prove.real import Comparison, examples_folder, markdown, run_real
from sessions.prove.real_f16 import _torsion
from sessions.prove.real_figures import record_figure, withheld_figure
from sessions.prove.real_rows import Row
from sessions.prove.real_silverbox import _errors
from sessions.report.figures import AFTER, BEFORE, MEASURED


@pytest.fixture
def examples(request):
    return request.config.rootpath / "examples" / "recordings"


def called(*words):
    return CliRunner().invoke(app, ["prove", *map(str, words)])


# ------------------------------------------------------------------ the friction damper, which takes seconds


@pytest.fixture(scope="module")
def damped(recordings, request, tmp_path_factory):
    out = tmp_path_factory.mktemp("real")
    folder = request.config.rootpath / "examples" / "recordings"
    return run_real(recordings, folder, out, ["friction_damper"])


def test_the_friction_damper_is_told_with_intervals(damped):
    found = {r.measure: r for r in damped.rows}
    assert found["law"].found == "stick-slip with clearance"
    for measure in ("F_s, N", "backlash, mm", "half travel, mm", "full travel, mm"):
        value, half = (float(x) for x in found[measure].found.removesuffix(" (90 %)").split(" +- "))
        assert 0 < half < 0.2 * value
    assert found["full travel, mm"].published == "about 7 in all"


def test_work_a_cycle_stands_beside_the_published_and_refutes_a_dashpot(damped):
    rows = [r for r in damped.rows if "work a cycle" in r.measure]
    assert [r.published for r in rows] == ["337", "329", "", "", "299"]
    assert "2 Hz, 12.7 mm, held out" in rows[-1].measure
    for r in rows:
        seen, law, viscous = (float(x) for x in r.found.split("; "))
        assert law == pytest.approx(seen, rel=0.15)
        if r.published:
            assert seen == pytest.approx(float(r.published), rel=0.05)
        if r is rows[-1]:
            assert viscous > 2 * seen


def test_tables_and_figures_are_written(damped):
    content = json.loads((damped.out / "real.json").read_text())
    assert content == damped.as_dict()
    assert content["run"] == ["friction_damper"]
    assert content["files"] == ["friction_damper/component.json", "friction_damper/loops.svg"]
    text = (damped.out / "real.md").read_text()
    assert "| recording | measure | run here | published, not run here | asked for |" in text
    assert text.count("\n| friction damper |") == len(damped.rows)
    assert "![loops](friction_damper/loops.svg)" in text
    assert ET.parse(damped.out / "friction_damper" / "loops.svg").getroot().tag.endswith("svg")


def test_the_command_says_where_its_tables_are(recordings, examples, tmp_path):
    done = called(
        "real", "--recordings", recordings, "--examples", examples, "--only", "friction_damper", "-o", tmp_path
    )
    assert done.exit_code == 0, done.output
    assert "run here" in done.stdout
    assert f"the table is in {tmp_path / 'real.md'} and real.json" in done.stderr


# ------------------------------------------------------------------ what is absent or misspelt


@pytest.fixture
def quick(monkeypatch):
    """Sets that take no time: each gives one row and one file."""

    def run(data, examples, out, progress):
        out.mkdir(parents=True)
        (out / "one.svg").write_text("<svg/>")
        progress("running")
        return [Row(data.name, "error", "0.1", "0.2", "0.15")]

    monkeypatch.setattr(real, "RUNS", dict.fromkeys(real.SETS, run))


def test_folders_that_are_absent_are_told(quick, examples, tmp_path):
    (tmp_path / "data" / "f16").mkdir(parents=True)
    done = called("real", "--recordings", tmp_path / "data", "--examples", examples, "-o", tmp_path / "out")
    assert done.exit_code == 0, done.output
    for name in ("silverbox", "friction_damper"):
        assert f"Not run: {name}; the recordings' folder does not hold it." in done.stderr
        assert f"Not run: {name}" in (tmp_path / "out" / "real.md").read_text()
    assert json.loads((tmp_path / "out" / "real.json").read_text())["absent"] == ["silverbox", "friction_damper"]


def test_peers_that_were_run_elsewhere_are_pointed_to(quick, examples, tmp_path):
    (tmp_path / "data" / "silverbox").mkdir(parents=True)
    told = ["real", "--recordings", tmp_path / "data", "--examples", examples, "-o", tmp_path / "out"]
    assert "benchmarks/silverbox_comparators.py" in called(*told).stderr
    rows = json.loads(called(*told[:-1], tmp_path / "again", "--json").stdout)["rows"]
    assert rows == [{"recording": "silverbox", "measure": "error", "found": "0.1", "published": "0.2", "asked": "0.15"}]


def test_progress_names_the_recording(quick, examples, tmp_path):
    (tmp_path / "f16").mkdir()
    told = []
    run_real(tmp_path, examples, tmp_path / "out", ["f16"], told.append)
    assert told == ["f16", "f16: running"]


def test_nothing_to_run_is_an_error(examples, tmp_path):
    with pytest.raises(FileError, match="holds none of the folders silverbox, f16, friction_damper"):
        run_real(tmp_path, examples, tmp_path / "out")
    with pytest.raises(ConfigError, match="--only silver: the real recordings are silverbox, f16, friction_damper"):
        run_real(tmp_path, examples, tmp_path / "out", ["silver"])
    assert not (tmp_path / "out").exists()


def test_examples_are_found_in_the_checkout_and_missed_in_words(tmp_path, monkeypatch, examples):
    monkeypatch.chdir(tmp_path)
    assert examples_folder() == examples
    with pytest.raises(FileError, match="nowhere: no such folder; --examples takes the folder examples/recordings"):
        examples_folder(tmp_path / "nowhere")
    monkeypatch.setattr(real, "__file__", str(tmp_path / "site-packages" / "sessions" / "prove" / "real.py"))
    with pytest.raises(FileError, match=r"examples.recordings: no such folder"):
        examples_folder()


def test_a_misspelt_suite_is_told_all_suites():
    done = called("reel")
    assert done.exit_code == 1
    assert isinstance(done.exception, ConfigError)
    assert str(done.exception) == "suite 'reel' is not one of linear, nonlinear, limits, dissertation, real"
    with pytest.raises(ConfigError, match="--recordings is missing"):
        CliRunner().invoke(app, ["prove", "real"], catch_exceptions=False)


def test_markdown_keeps_run_here_and_published_apart(tmp_path):
    rows = [Row("Silverbox", "arrow", "0.308", "0.26", "0.30"), Row("Silverbox", "k3", "3.9")]
    lines = markdown(Comparison(tmp_path, rows, (), ("f16",), ("a note",))).splitlines()
    assert "| Silverbox | arrow | 0.308 | 0.26 | 0.30 |" in lines
    assert "| Silverbox | k3 | 3.9 |  |  |" in lines
    assert "- a note" in lines


# ------------------------------------------------------------------ errors and figures of the long recordings


def test_errors_of_a_record_without_its_mean_and_its_start():
    """RMS by definition: an offset of 3 mV, an alternating error of 4 mV, and a start that is 1 V off."""
    n = 1000
    measured = np.zeros(n)
    made = 3e-3 + 4e-3 * np.where(np.arange(n) % 2, 1.0, -1.0)
    made[:50] += 1.0
    whole, level, rest = (float(r.found) for r in _errors("arrow", measured, made, "0.26", "0.30"))
    left = -1e3 * made
    assert whole == pytest.approx(np.sqrt(np.mean(left**2)), abs=1e-3)
    assert level == pytest.approx(np.std(left), abs=1e-3)
    assert rest == pytest.approx(4.0, abs=1e-3)


@dataclass(frozen=True)
class Excited:
    """What a figure asks of a periodic run."""

    outputs: tuple[Channel, ...]
    period: int = 8192
    rate: float = 400.0
    lasting: bool = True

    @property
    def excited(self):
        return np.ones(self.period // 2 + 1, bool)


def predicted(hertz, made):
    """One response with a peak at a frequency, and another one that a model makes."""
    line = np.arange(41, 300)
    f = line * 400.0 / 8192
    peaks = [1 / (h**2 - f**2 + 2j * 0.01 * h * f) for h in (hertz, made)]
    force = np.full(f.size, 2.0 + 1.0j)
    return Predicted(Excited((Channel("acc3"),)), f, force, *(p[None] * force for p in peaks))  # ty: ignore


def test_the_peaks_of_measured_and_simulated_torsion():
    found = _torsion(predicted(7.25, 7.10))
    assert found is not None
    seen, made = found
    assert seen == pytest.approx((7.25, 0.01), rel=0.01)
    assert made == pytest.approx((7.10, 0.01), rel=0.01)
    assert _torsion(predicted(12.0, 12.0)) is None


def test_figures_are_small_and_draw_all_three_curves(tmp_path):
    found = predicted(7.3, 7.1)
    peaks = {"multisine": [(12.0, 7.30, 7.31, False), (74.0, 7.2, 7.22, True)], "sweep": [(4.8, 7.3, 7.3, False)]}
    withheld_figure(tmp_path / "withheld.svg", found, found, "level 5, withheld", peaks)
    y = np.sin(np.linspace(0, 900, 40500)) * np.linspace(0, 1, 40500)
    record_figure(tmp_path / "arrow.svg", 610.35, y, 0.9 * y, 0.99 * y, "V")
    for drawn in tmp_path.iterdir():
        assert drawn.stat().st_size < 60_000
        points = {}
        for e in ET.parse(drawn).getroot().iter("{http://www.w3.org/2000/svg}path"):
            for colour in (MEASURED, BEFORE, AFTER):
                if f"stroke: {colour}" in e.get("style", ""):
                    points[colour] = max(points.get(colour, 0), e.get("d", "").count("L"))
        assert sorted(points) == sorted((MEASURED, BEFORE, AFTER))
        assert min(points.values()) > 30
