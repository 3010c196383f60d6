"""The report: one self-contained page that says what the session holds, and nothing that it does not."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.block import Block
from labnnum.errors import FileError
from labnnum.frf import Frf
from labnnum.parameters import Estimate, Parameter
from labnnum.recording import Channel
from sessions.estimates import StoredEstimate, store_estimate
from sessions.report.content import gather
from sessions.report.diagnosis import _in_stretches, rivals_section
from sessions.report.page import render, verdict, write_report
from sessions.report.sections import SECTIONS, Section
from sessions.store import create_session, open_session

LINES = np.linspace(1.0, 200.0, 400)
BASE = Channel("base", "acceleration", "base", node="1", direction="z", sensitivity=0.1)
NODE = Channel("a<3>", "acceleration", "response", node="3", direction="z", sensitivity=0.1)
PARAMETERS = (Parameter("m_acc", 10e-3, 7e-3, 13e-3, "kg", 2e-3), Parameter("alpha", 1.5, 0.5, 2.5, "1/s"))


def oscillator(frequency: float, ratio: float) -> np.ndarray:
    s = 1j * LINES / frequency
    return ((1 + 2 * ratio * s) / (1 + 2 * ratio * s + s**2))[None, None]


def make_session(
    path: Path, chi2: float = 1.02, warnings: tuple[str, ...] = (), converged: bool = True, floor: float | None = None
) -> Path:
    rng = np.random.default_rng(0)
    truth = oscillator(60.0, 0.02)
    variance = np.abs(truth) ** 2 * 1e-3
    noise = np.sqrt(variance / 2) * (rng.standard_normal(truth.shape) + 1j * rng.standard_normal(truth.shape))
    settings = {"window": "hann", "n_segment": 1024, "rate": 1000.0, "overlap": 0.5}
    coherence = np.full((1, LINES.size), 0.98)
    frf = Frf(LINES, truth + noise, (NODE,), (BASE,), coherence, variance, 40.0, "H1", settings)
    estimate = Estimate(
        PARAMETERS, [10.2e-3, 1.4], np.diag([1e-9, 1e-2]), "network + least squares", chi2, warnings, converged
    )
    with create_session(path, rig_text="[rig]\n", model_text='kind = "beam"\n') as session:
        run = session.start_run((BASE, NODE), 1000.0, level=0.4)
        run.append(Block(rng.standard_normal((2, 4096)), 0, 0.0))
        run.append(Block(rng.standard_normal((2, 4096)), 4100, 4.1, lost=4, overload=np.array([False, True])))
        run.add_hit(10, 500)
        run.add_hit(600, 900, accepted=False, reason="double hit at 12 ms")
        run.finish()
        where = session.add_frf(frf)
        before = oscillator(70.0, 0.02)
        made = {"seed": 3} if floor is None else {"seed": 3, "floor": floor}
        stored = StoredEstimate(estimate, where, LINES, before, truth, ((50.0, 70.0),), {"m_acc": 10.1e-3}, made)
        store_estimate(session, stored)
    return path


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("report")
    session = make_session(folder / "beam.h5")
    return write_report(session, folder / "beam.html").read_text(encoding="utf-8")


def test_it_is_self_contained(page):
    assert not re.findall(r'(?:src|href)="(?!#|data:|https?://www\.w3\.org)[^"]*"', page)
    assert "@import" not in page
    assert page.count("<svg") == page.count("</svg>") >= 4
    assert "<script" not in page


def test_ids_are_unique(page):
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))


def test_it_says_what_the_session_holds(page):
    for text in (
        "(10.200 ± 0.032) ×10⁻³ kg", "+3.16", "2 parameters updated", "network + least squares", "hann",
        "double hit at 12 ms", "1 of 2", "4 frames lost", "a&lt;3&gt;", "kind = &#34;beam&#34;", "0.980",
    ):  # fmt: skip
        assert text in page, text
    assert "a<3>" not in re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL)


def test_sections_stand_in_order(page):
    anchors = re.findall(r'<section id="([^"]+)">', page)
    assert anchors == ["parameters", "frf", "trust", "measurement", "provenance"]


def test_a_further_section_is_one_function(tmp_path):
    session = make_session(tmp_path / "s.h5")
    content = gather(session, extra={"diagnosis": "added mass at node 3"})

    def diagnosis(content):
        return Section("diagnosis", "Diagnosis", content.extra["diagnosis"])

    assert "added mass at node 3" in render(content, (*SECTIONS, diagnosis))


@pytest.mark.parametrize(
    ("how", "kind", "words"),
    [
        ({}, "good", "within its random error."),
        ({"floor": 0.0}, "good", "within its random error."),
        ({"floor": 0.05}, "good", "within its random error and a model error of 5 %."),
        ({"chi2": 7.0}, "doubt", "7 times chance."),
        ({"chi2": 7.0, "floor": 0.05}, "doubt", "7 times what chance and a model error of 5 % would leave"),
        ({"warnings": ("outside the training range",)}, "doubt", "1 warning to read"),
        ({"converged": False}, "doubt", "did not converge"),
        ({"chi2": float("nan")}, "none", "could not be judged"),
    ],
)
def test_the_verdict(tmp_path, how, kind, words):
    said = verdict(gather(make_session(tmp_path / "s.h5", **how)))
    assert said[1] == kind
    assert words in said[0]


def test_raw_data_alone_make_a_report(tmp_path):
    with create_session(tmp_path / "s.h5") as session:
        session.start_run((BASE, NODE), 1000.0).append(Block(np.zeros((2, 64)), 0, 0.0))
    page = render(gather(tmp_path / "s.h5"))
    assert "Raw data only" in page
    assert "cut off" in page


def test_a_session_is_never_written_over(tmp_path):
    session = make_session(tmp_path / "s.h5")
    with pytest.raises(FileError, match="not written over"):
        write_report(session, session)
    with open_session(session) as still:
        assert still.runs


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    session = make_session(tmp_path / "s.h5")
    with pytest.raises(FileError, match="choose another place"):
        write_report(session, tmp_path / "nowhere" / "r.html")


def test_no_curve_is_drawn_over_lines_that_were_not_held_out():
    frequency = np.array([1.0, 2.0, 3.0, 10.0, 11.0, 12.0])
    x, y = _in_stretches(frequency, 2.0 * frequency)
    np.testing.assert_array_equal(np.isnan(x), [0, 0, 0, 1, 0, 0, 0])
    np.testing.assert_array_equal(y, 2.0 * x)


@pytest.mark.parametrize(("error", "shown"), [(float("nan"), False), (0.021, True)])
def test_rivals_that_foretold_nothing_have_no_column_for_it(error, shown):
    term = SimpleNamespace(mechanism=SimpleNamespace(id="clearance"), place="joint 2-3")
    rival = SimpleNamespace(term=term, held_out_error=error, why_not="leaves 300 more")
    page = rivals_section(SimpleNamespace(alternatives=(rival,), located=(), chance=0.2)).body
    assert ("held-out error" in page, "2.1 %" in page) == (shown, shown)
    assert "nan" not in page
