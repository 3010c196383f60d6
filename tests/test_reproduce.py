import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.errors import ConfigError, FileError
from sessions.cli import app
from sessions.reproduce import run, study
from sessions.reproduce.cases import CASES, chosen
from sessions.reproduce.keep import load_progress, save_progress
from sessions.reproduce.run import reproduce_case
from sessions.reproduce.study import Effort, Progress

SMALL = Effort(sets=60, noises=(0.0, 0.01), noisy_samples=400, centres=120, nominal=10)


def case_of(name, samples):
    """With fewer samples than the dissertation, to be quick."""
    return replace(CASES[name](), samples=samples)


@pytest.fixture(scope="module")
def truck():
    return study.study(case_of("truck-2", 250), SMALL)


@pytest.mark.parametrize("name", [n for n in CASES if not n.startswith("frame")])
def test_published_errors_name_the_parameters_of_their_case(name):
    case = CASES[name]()
    solver = case.solver()
    assert tuple(case.published) == tuple(p.name for p in solver.parameters)
    assert len(case.labels) == solver.shape[0] * solver.shape[1]
    assert solver.shape[2] == case.frequency.size


@pytest.mark.parametrize("name", ["truck-2", "duffing-scales"])
def test_lines_in_each_band_can_be_chosen(name):
    case = CASES[name]()
    assert case.with_lines(0) is case
    more = case.with_lines(20)
    inside = [(more.frequency >= b.low) & (more.frequency <= b.high) for b in more.bands]
    assert all(i.sum() == 20 for i in inside)
    assert more.solver().shape[2] == more.frequency.size
    theta = np.array([[(p.lower + p.upper) / 2 for p in more.solver().parameters]])
    shared = np.flatnonzero(np.isclose(case.frequency, more.bands[0].low, rtol=1e-12))
    assert np.allclose(more.solver().frf(theta)[..., 0], case.solver().frf(theta)[..., shared[0]], rtol=1e-9)


def test_refined_errors_stand_on_the_bound(truck):
    assert (truck.of("refined", 0.0).most < 1e-6).all()
    assert truck.of("refined", 0.0).failures == truck.of("refined", 0.01).failures == 0
    assert np.allclose(truck.efficiency[0.01], 1.0, atol=0.3)
    assert (truck.of("refined", 0.01).coverage > 0.75).all()


def test_our_network_is_better_than_the_one_as_printed(truck):
    assert (truck.of("network", 0.0).most < 0.2 * truck.of("printed", 0.0).mean).all()
    assert (truck.of("network, 1 %", 0.01).mean < 0.7 * truck.of("network", 0.01).mean).all()


def test_the_same_seed_gives_the_same_numbers_in_one_run_or_two(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "CHUNK", 25)
    case = case_of("truck-2", 60)

    class Stopped(Exception):
        pass

    def stop(found):
        save_progress(tmp_path, "truck-2", SMALL, found)
        if found.done == 50:
            raise Stopped

    with pytest.raises(Stopped):
        study.study(case, SMALL, save=stop)
    resumed = load_progress(tmp_path, "truck-2", SMALL)
    assert resumed.done == 50
    again = study.study(case, SMALL, resume=resumed)
    whole = study.study(case, SMALL)
    for a, b in zip(again.errors, whole.errors, strict=True):
        assert a.method == b.method
        assert np.array_equal(a.signed, b.signed)
    assert load_progress(tmp_path, "truck-2", Effort()) is None
    save_progress(tmp_path, "truck-2", SMALL, Progress())
    (tmp_path / "truck-2.partial.npz").write_bytes(b"rubbish")
    with pytest.raises(FileError, match="cannot be read"):
        load_progress(tmp_path, "truck-2", SMALL)


def test_a_set_that_noise_does_not_explain_is_tried_from_elsewhere():
    effort = Effort(sets=12, noises=(0.01,), noisy_samples=200, centres=100, nominal=0)
    assert study.study(case_of("kabe-undamped", 300), effort).of("refined", 0.01).failures == 0


def test_the_command_writes_tables_and_a_page_and_works_no_case_twice(tmp_path, monkeypatch):
    monkeypatch.setitem(CASES, "truck-1", partial(replace, CASES["truck-1"](), samples=60))
    arguments = ["reproduce", "truck-1", "-o", str(tmp_path / "out"), "--cases", "40", "--samples", "200"]
    first = CliRunner().invoke(app, arguments)
    assert first.exit_code == 0, first.output
    assert "as printed" in first.stdout
    page = (tmp_path / "out" / "truck-1.html").read_text()
    assert page.count("<svg") == 2
    rows = (tmp_path / "out" / "truck-1.csv").read_text().splitlines()
    assert rows[0].startswith("case,noise,method,parameter")
    assert len(rows) == 2 + 3 + 5 + 5
    monkeypatch.setattr(run, "study", None)  # a finished case is not worked again
    second = CliRunner().invoke(app, [*arguments, "--json"])
    found = json.loads(second.stdout)
    assert found[0]["noise"][1]["failures"] == 0
    assert found[0]["names"] == ["m3"]


def test_progress_is_told(tmp_path, monkeypatch):
    told = []
    monkeypatch.setitem(CASES, "truck-1", partial(replace, CASES["truck-1"](), samples=60))
    reproduce_case("truck-1", Effort(sets=10, noises=(0.0,), noisy_samples=0, nominal=0), tmp_path,
                   lambda *what: told.append(what))  # fmt: skip
    assert told[-1] == ("verifying", 10, 10)


def test_words_that_mean_nothing_are_refused():
    assert len(chosen("truck")) == 6
    assert chosen("kabe") == ("kabe-undamped", "kabe-damped")
    assert set(chosen("")) == set(CASES)
    with pytest.raises(ConfigError, match="no example 'bus'; there are truck-1"):
        chosen("bus")
    with pytest.raises(ConfigError, match="--cases"):
        CliRunner().invoke(app, ["reproduce", "truck-1", "--cases", "-3"], catch_exceptions=False)
