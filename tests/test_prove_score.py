"""Judging, measuring and running: exact answers on made-up truths, and a whole suite with an oracle for a tool."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from labnnum.errors import ConfigError, FileError
from labnnum.mechanisms import Place, QuadraticStiffness
from labnnum.mechanisms.extended import site_of
from sessions.model import read_model
from sessions.prove import answers, listing, measures, run, score, seal, visible
from sessions.prove.cases import conceal, write_case
from sessions.prove.intervals import Share, clopper_pearson, half_point
from sessions.prove.suite import draw
from sessions.prove.truth import fe
from sessions.prove.truth.physics import node_row
from sessions.prove.words import axis_name

BAND = (5.0, 100.0)


def place(kind, name, to=None):
    return {"kind": kind, "id": name, "to": to}


def fault(mechanism="added-mass", where=None, **more):
    base = {"mechanism": mechanism, "inside": True, "place": where or place("node", "3"), "severity": 0.5}
    return base | {"measure": 0.1, "measure_of": "x", "parameters": {}, "sense": "", "places": [], "accept": []} | more


def truth(*faults, family="structure"):
    return {"case": "c", "family": family, "kind": "chain", "excitation": "multisine", "sensors": 3} | {
        "faults": list(faults),
        "band": BAND,
    }


def answer(verdict="missing-physics", where=None, mechanism=None, **more):
    named = {"id": mechanism, "parameters": more.pop("parameters", {})} if mechanism else None
    return {"verdict": verdict, "place": where, "mechanism": named, "further": [], "located": []} | more


def test_clopper_pearson_agrees_with_the_binomial_distribution():
    for k, n in ((0, 10), (3, 10), (10, 10), (37, 400)):
        low, high = clopper_pearson(k, n)
        exact = stats.binomtest(k, n).proportion_ci(0.95, "exact")
        assert (low, high) == pytest.approx((exact.low, exact.high), abs=1e-12)


def test_half_point_is_where_half_are_found():
    rng = np.random.default_rng(0)
    x = rng.random(600)
    found = rng.random(600) < 1 / (1 + np.exp(-18 * (x - 0.4)))
    assert half_point(x, found) == pytest.approx(0.4, abs=0.03)
    assert np.isnan(half_point([0.2, 0.8], [True, True]))
    assert np.isnan(half_point([0.5, 0.6, 0.7, 0.8, 0.9], [True, True, True, True, False]))  # not where they lie


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (place("node", "3"), place("ground", "3"), True),
        (place("support", "1"), place("node", "1"), True),
        (place("joint", "3", "4"), place("element", "4", "3"), True),
        (place("joint", "3", "4"), place("element", "3", "5"), False),
        (place("node", "3"), place("node", "4"), False),
        (place("channel", "a1"), place("channel", "a2"), False),
        (place("global", "structure"), place("system", "x"), True),
        (place("node", "3"), place("joint", "3", "4"), False),
    ],
)
def test_places_are_one_or_are_not(one, other, same):
    assert answers.same_place(one, fault(where=other)) is same
    assert answers.same_place(other, fault(where=one)) is same


def test_a_node_touches_its_elements():
    assert answers.adjacent(place("node", "3"), fault(where=place("joint", "3", "4")))
    assert not answers.adjacent(place("node", "5"), fault(where=place("joint", "3", "4")))


def test_exchanged_channels_are_named_by_either():
    swap = fault("channel-swap", place("channel", "a1", "a3"), places=[place("channel", "a3", "a1")])
    assert answers.same_place(place("channel", "a3", "a1"), swap)
    assert answers.same_place(place("channel", "a1"), swap)
    assert not answers.same_place(place("channel", "a1", "a2"), swap)


def test_equivalents_count_only_where_they_are_meant():
    stiff = fault("attached-oscillator", accept=[["added-mass", place("node", "3")]])
    right = answer(where=place("ground", "3"), mechanism="added-mass")
    assert answers.judge(truth(stiff), right).name_right
    assert not answers.judge(truth(fault("attached-oscillator")), right).name_right
    inverted = fault("channel-swap", place("channel", "a1"), accept=[["channel-gain", place("channel", "a1")]])
    for gain, ok in ((-2.0, True), (-0.3, False)):
        said = answer(
            "measurement-fault", place("channel", "a1"), "channel-gain", parameters={"gain_error": {"value": gain}}
        )
        assert answers.judge(truth(inverted), said).name_right is ok
    high = {"frequency": {"value": 200.0, "std": 1.0}}
    said = answer(where=place("node", "3"), mechanism="attached-oscillator", parameters=high)
    assert answers.judge(truth(fault()), said).name_right


def test_nothing_said_about_a_sound_structure_is_right():
    judged = answers.judge(truth(family="null"), answer("parameters"))
    assert not judged.alarm
    assert not judged.named
    assert answers.judge(truth(family="null"), answer("unexplained", place("node", "1"))).alarm


def test_the_first_place_is_the_declared_one_or_the_best_located():
    located = [{"place": place("node", "3"), "share": 0.8}]
    assert answers.judge(truth(fault()), answer("unexplained", None, located=located)).place_right
    assert not answers.judge(truth(fault()), answer("unexplained", place("node", "9"), located=located)).place_right


def test_parameter_errors_by_any_of_their_names():
    known = fault(parameters={"m": {"value": 2.0, "unit": "kg"}})
    said = answer(where=place("node", "3"), mechanism="added-mass", parameters={"mass": {"value": 2.1, "std": 0.05}})
    assert answers.judge(truth(known), said).errors["added-mass.m"] == pytest.approx((0.05, 2.0))


@pytest.mark.parametrize(
    ("where", "named", "k2", "error"),
    [
        (place("ground", "3"), place("ground", "3"), 2.0, 0.0),
        (place("ground", "3"), place("ground", "3"), -2.0, -2.0),
        (place("joint", "3", "4"), place("joint", "3", "4"), 2.0, 0.0),
        (place("joint", "3", "4"), place("joint", "3", "4"), -2.0, -2.0),
        (place("joint", "3", "4"), place("joint", "4", "3"), -2.0, 0.0),
        (place("joint", "3", "4"), place("joint", "4", "3"), 2.0, -2.0),
        (place("joint", "3", "4"), place("ground", "4"), -2.2, 0.1),  # moves alike, in a sense that nobody tells
    ],
)
def test_a_spring_that_pulls_one_way_only_must_pull_that_way(where, named, k2, error):
    known = {"k2": {"value": 2.0, "unit": "N/m^2"}}
    law = fault("quadratic-stiffness", where, parameters=known, places=[place("ground", "4")])
    said = answer(where=named, mechanism="quadratic-stiffness", parameters={"k2": {"value": k2, "std": 0.1}})
    assert answers.judge(truth(law), said).errors["quadratic-stiffness.k2"] == pytest.approx((error, 20 * error))


@pytest.mark.parametrize("k2", [2.0, -2.0])
def test_the_sense_of_an_angle_is_the_models_own(k2):
    known = {"k2": {"value": 2.0, "unit": "N/m^2, of the angle"}}
    law = fault("quadratic-stiffness", place("joint", "3", "4"), parameters=known)
    said = answer(where=law["place"], mechanism="quadratic-stiffness", parameters={"k2": {"value": k2, "std": 0.1}})
    assert answers.judge(truth(law), said).errors["quadratic-stiffness.k2"] == (0.0, 0.0)


JOINTED = [("chain", 2, 1.0), ("base-beam", 0, 1.0), ("frame", 0, 1.0), ("free-beam", 0, 1.0), ("free-beam", 1, -1.0)]


@pytest.mark.parametrize(("kind", "seed", "turned"), JOINTED)
def test_a_concealed_joint_moves_as_the_users_model_says_of_its_nodes_in_that_order(kind, seed, turned, tmp_path):
    """Only an angle may be turned: that of a model whose z is the bench's second axis has the other sense."""
    case = conceal(seed, kind, "quadratic-stiffness", 0.6)
    (law,), (told,) = case.state.laws, case.state.faults
    assert told.place["kind"] == "joint"
    a, b = told.place["id"], told.place["to"]
    mesh = case.state.mesh
    (axis,) = (i for i in range(3) if law.row[mesh.dof(b, i)] != 0)
    assert (axis == 2) == ("of the angle" in told.parameters["k2"]["unit"])
    along = 0 if kind == "chain" else 1
    w = 2 * np.pi * np.linspace(*case.state.bench.band, 60)
    there = motion(*fe.assemble(mesh)[:2], node_row(case.state, b, along)[0], law.row, w, mesh.active)

    write_case(case, tmp_path)
    structure = read_model(tmp_path / "model.toml").structure
    m = structure.matrices(structure.nominal)
    seen = structure.participation(f"{b}:{axis_name(case.state.bench, along)}", structure.nominal)
    for place, sense in ((Place("joint", a, b), 1.0), (Place("joint", b, a), -1.0)):
        column = QuadraticStiffness().at(site_of(structure), place, axis_name(case.state.bench, axis)).data["column"]
        here = motion(m.M, m.K, seen, column, w)
        assert alike(here, there) * sense * turned > 0.7


def alike(one, other):
    """Cosine between two responses: near 1 where they are one, near -1 where they are turned round."""
    return np.vdot(one, other).real / (np.linalg.norm(one) * np.linalg.norm(other))


def motion(mass, stiffness, seen, load, omega, active=slice(None)):
    """Motion `seen` under a force `load` at each frequency, damped so much that no resonance stands out."""
    M, K = (x[active][:, active] for x in (mass, stiffness))
    return np.array([seen[active] @ np.linalg.solve((1 + 0.5j) * K - w**2 * M, load[active]) for w in omega])


def scored(family, judged_answer, *faults, visibility=50.0):
    t = truth(*faults, family=family)
    return measures.Scored(t, answers.judge(t, judged_answer), visibility, (visibility,) * len(faults), 1.0)


def by_name(cases):
    return {m.name: m for m in measures.table(cases)}


def test_the_table_counts_what_it_says():
    right = answer(where=place("node", "3"), mechanism="added-mass")
    wrong = answer(where=place("node", "3"), mechanism="ground-stiffness")
    cases = [
        scored("null", answer("consistent")),
        scored("null", answer("unexplained", place("node", "1"))),
        scored("structure", right, fault()),
        scored("structure", wrong, fault()),
        scored("structure", answer("unexplained", place("node", "3")), fault()),
        scored("structure", answer("consistent"), fault(), visibility=1.0),
        scored("outside", answer("unexplained", place("node", "3")), fault("lever-spring")),
        scored("outside", right, fault("lever-spring")),
    ]
    found = by_name(cases)
    assert found["false alarm on nulls"].share == Share(1, 2)
    assert found["place, first choice, visible: linear"].share == Share(3, 3)
    assert found["right among the names declared, visible"].share == Share(1, 2)
    assert found["declared at all, visible, in the catalogue"].share == Share(2, 3)
    assert found["outside the catalogue, falsely named"].share == Share(1, 2)
    assert found['outside, "unexplained" at the right place'].share == Share(1, 2)
    whys = [f["why"] for f in listing.failures(cases)]
    assert whys == ["false alarm", "wrong name", "not named", "falsely named"]


def test_groups_split_the_visible_single_faults():
    right = answer(where=place("node", "3"), mechanism="added-mass")
    cases = [scored("structure", right, fault()), scored("structure", answer("parameters"), fault(), visibility=5.0)]
    found = {(g.by, g.value): (g.n, g.place, g.named, g.right) for g in listing.groups(cases)}
    assert found[("structure", "chain")] == (2, 1, 1, 1)
    assert found[("visibility", "30 to 100")] == (1, 1, 1, 1)
    assert found[("visibility", "3 to 10")] == (1, 0, 0, 0)
    assert found[("sensors", "2 to 4")] == (2, 1, 1, 1)


def test_a_second_name_too_many_is_counted():
    other = {"place": place("node", "5"), "mechanism": {"id": "drift"}}
    said = answer(where=place("node", "3"), mechanism="added-mass", further=[other])
    found = by_name([scored("structure", said, fault())])
    assert found["a further name that is wrong, one fault"].share == Share(1, 1)


def test_two_at_once():
    other = {"place": place("channel", "a1"), "mechanism": {"id": "channel-gain"}}
    both = answer(where=place("node", "3"), mechanism="added-mass", further=[other])
    pair = (fault(), fault("channel-gain", place("channel", "a1")))
    found = by_name([scored("double", both, *pair), scored("double", both, pair[0], fault("drift"))])
    assert found["two at once: both named"].share == Share(1, 2)
    assert found["two at once: first named is one of them"].share == Share(2, 2)


def test_a_case_without_answer_counts_as_silence():
    t = truth(fault())
    silent = measures.Scored(t, None, 50.0, (50.0,), float("nan"), "it broke")
    assert by_name([silent])["declared at all, visible, in the catalogue"].share == Share(0, 1)
    assert listing.failures([silent])[0]["why"] == "no answer: it broke"


def test_a_suite_is_the_same_for_its_seed_and_holds_every_family():
    one, again, other = draw(80, 3), draw(80, 3), draw(80, 4)
    assert one == again
    assert one != other
    assert {t.family for t in one} == {"null", "structure", "channel", "outside", "double"}
    assert seal.text("linear", 3, one[:6]) == seal.text("linear", 3, again[:6])


def oracle(truths):
    """A tool that looks into the sealed file: what it answers must be scored as all right."""

    def diagnose(recordings, model, out):
        t = truths[model.parent.name]
        assert all(p.is_file() for p in recordings)
        assert not (model.parent / "truth.json").exists()
        entries = [
            {
                "place": f["place"],
                "mechanism": {
                    "id": f["mechanism"],
                    "parameters": {k: v | {"std": abs(v["value"])} for k, v in f["parameters"].items()},
                },
            }
            for f in t["faults"]
            if f["inside"]
        ]
        where = t["faults"][0]["place"] if t["faults"] else None
        said = {"verdict": "missing-physics" if entries else "unexplained" if where else "parameters", "place": where}
        said |= {"mechanism": entries[0]["mechanism"] if entries else None, "further": entries[1:], "located": []}
        said["fit"] = {"base": {"held_out": 0.5}, "extended": {"held_out": 0.05}}
        (out / "diagnosis.json").write_text(json.dumps(said))
        return said

    return diagnose


def test_a_whole_suite_with_an_oracle_reaches_every_goal(tmp_path, monkeypatch):
    monkeypatch.setattr(visible, "NULLS", 3)
    order = run.Order("linear", 14, 11, tmp_path, tool="oracle:diagnose")
    tickets, sha256 = run.start(order)
    truths = {c["case"]: c for c in seal.unseal(tmp_path)["cases"]}
    monkeypatch.setattr(run, "load", lambda tool: oracle(truths))
    run.diagnose_all(order, tickets[:9])
    run.diagnose_all(order, tickets)
    found = run.score_all(order, tickets, sha256)
    assert found["cases"] == 14
    assert [m["name"] for m in found["measures"] if m["reached"] is False] in (
        [],
        ["90 % intervals that hold the truth"],
    )
    assert found["failures"] == []
    assert sha256 in (tmp_path / "score.md").read_text()
    assert not list((tmp_path / "cases").iterdir())


def test_a_tool_that_breaks_leaves_its_reason_and_is_asked_again(tmp_path, monkeypatch):
    monkeypatch.setattr(visible, "NULLS", 2)

    def broken(recordings, model, out):
        raise ZeroDivisionError("by nought")

    monkeypatch.setattr(run, "load", lambda tool: broken)
    order = run.Order("linear", 2, 12, tmp_path, keep=True)
    tickets, sha256 = run.start(order)
    run.diagnose_all(order, tickets)
    found = run.score_all(order, tickets, sha256)
    assert all("by nought" in f["why"] for f in found["failures"])
    assert len(list((tmp_path / "cases").iterdir())) == 2
    assert not score.answer_path(tmp_path, "case0001").is_file()


def test_a_tool_that_writes_nothing_counts_as_one_that_says_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "load", lambda tool: lambda recordings, model, out: None)
    order = run.Order("linear", 1, 12, tmp_path)
    tickets, _ = run.start(order)
    run.diagnose_all(order, tickets)
    assert "no diagnosis.json" in (tmp_path / "answers" / "case0001" / "error.txt").read_text()


def test_a_folder_of_another_suite_is_refused(tmp_path):
    run.start(run.Order("linear", 2, 1, tmp_path))
    with pytest.raises(ConfigError, match="another suite"):
        run.start(run.Order("linear", 2, 2, tmp_path))


@pytest.mark.parametrize(
    ("change", "words"), [({"cases": 0}, "--cases"), ({"jobs": 0}, "--jobs"), ({"suite": "odd"}, "odd")]
)
def test_what_makes_no_sense_is_refused(tmp_path, change, words):
    order = SimpleNamespace(**({"suite": "linear", "cases": 2, "seed": 1, "out": tmp_path, "jobs": 1} | change))
    with pytest.raises(ConfigError, match=words):
        run.start(order)


def test_a_missing_truth_is_told(tmp_path):
    with pytest.raises(FileError, match="--draw-only"):
        seal.unseal(tmp_path)


def test_a_tool_that_is_none_is_refused():
    with pytest.raises(ConfigError, match="module:function"):
        run.load("nowhere.at.all:f")
