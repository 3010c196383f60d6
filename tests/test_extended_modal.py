"""extended.toml of a modal structure: every mode has the damping that was fitted to it, by number or by parameter."""

import numpy as np
import pytest

from labnnum.diagnosis import observe_frf
from labnnum.frf import Frf
from labnnum.recording import Channel
from labnnum.response import frf, modes
from sessions.diagnose import run_observed, write_extended
from sessions.model import parse_model, read_model

OUTPUTS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in (1, 2, 3))
FORCE = (Channel("f", "force", "reference", "1", "x"),)
LINES = np.linspace(4.0, 40.0, 900)
SHAPES = {10.0: (0.8, 0.6, 0.5), 18.0: (0.7, -0.4, -0.6), 31.0: (0.5, -0.7, 0.6)}
TRUE = {10.0: 0.012, 18.0: 0.025, 31.0: 0.04}


def text(ratio, order=(31.0, 18.0, 10.0), parameters=()):
    """A modal model whose modes stand in an order of frequency, with the damping ratios that `ratio` says."""
    lines = ["[structure]", 'kind = "modal"']
    for f in order:
        shape = ", ".join(f'"{i}:x" = {v}' for i, v in enumerate(SHAPES[f], 1))
        lines += ["[[structure.mode]]", f"frequency = {f}", f"damping_ratio = {ratio[f]}", f"shape = {{{shape}}}"]
    for name, nominal, upper in parameters:
        lines += ["[[parameter]]", f'name = "{name}"', f"nominal = {nominal}", "lower = 0.001", f"upper = {upper}"]
    return "\n".join([*lines, ""])


def observed(tmp_path):
    truth = parse_model(text(TRUE), tmp_path / "truth.toml").structure
    value = frf(truth, truth.nominal, LINES, OUTPUTS, FORCE)
    scatter = 1e-3 * np.abs(value)
    noise = np.random.default_rng(2).standard_normal((2, *value.shape)) / np.sqrt(2)
    return observe_frf(
        Frf(LINES, value + scatter * (noise[0] + 1j * noise[1]), OUTPUTS, FORCE, variance=scatter**2, n_averages=16)
    )


def extended(tmp_path, model_text):
    """The extended model of the diagnosis with a model, read back from its file."""
    (tmp_path / "model.toml").write_text(model_text)
    model = read_model(tmp_path / "model.toml")
    answer = run_observed([observed(tmp_path)], model)
    assert answer.verdict in ("consistent", "parameters"), answer.summary
    write_extended(tmp_path / "extended.toml", model, answer)
    return read_model(tmp_path / "extended.toml")


def test_modes_that_were_identified_are_written_where_the_fit_has_them(tmp_path):
    """Of a model by hand a frequency is what its author says; of one that was identified it is a measurement."""
    off = text(TRUE).replace("frequency = 18.0", "frequency = 18.1")
    for error, close in ((0.0, 18.1), (0.01, 18.0)):
        model = extended(tmp_path, off.replace('kind = "modal"', f'kind = "modal"\nerror = {error}'))
        written = sorted(m["frequency"] for m in model.raw["structure"]["mode"])
        assert written == pytest.approx([10.0, close, 31.0], abs=0.01)


def damping_of(model):
    found = modes(model.structure, model.structure.nominal)
    return found.damping_ratio[: len(TRUE)]


@pytest.mark.parametrize("order", [(31.0, 18.0, 10.0), (18.0, 31.0, 10.0), (10.0, 18.0, 31.0)])
def test_modes_in_any_order_keep_their_own_damping(tmp_path, order):
    model = extended(tmp_path, text(dict.fromkeys(TRUE, 0.02), order))
    written = {m["frequency"]: m["damping_ratio"] for m in model.raw["structure"]["mode"]}
    assert [m["frequency"] for m in model.raw["structure"]["mode"]] == list(order)
    for f, z in TRUE.items():
        assert written[f] == pytest.approx(z, rel=0.02)
    np.testing.assert_allclose(damping_of(model), list(TRUE.values()), rtol=0.02)


def test_a_ratio_that_is_a_parameter_stays_one_and_takes_the_fitted_value(tmp_path):
    ratio = {10.0: 0.02, 18.0: '"z2"', 31.0: '"z3"'}
    model = extended(tmp_path, text(ratio, parameters=(("z2", 0.02, 0.05), ("z3", 0.02, 0.03))))
    by_name = {p.name: p for p in model.structure.parameters}
    assert by_name["z2"].nominal == pytest.approx(TRUE[18.0], rel=0.02)
    assert by_name["z2"].upper == 0.05
    assert by_name["z3"].nominal == pytest.approx(TRUE[31.0], rel=0.02)
    assert by_name["z3"].upper >= by_name["z3"].nominal
    np.testing.assert_allclose(damping_of(model), list(TRUE.values()), rtol=0.02)


def test_modes_that_share_a_parameter_are_damped_as_was_fitted_to_each(tmp_path):
    ratio = dict.fromkeys(TRUE, '"z"')
    model = extended(tmp_path, text(ratio, parameters=(("z", 0.02, 0.05),)))
    shared = float(np.exp(np.mean(np.log(list(TRUE.values())))))
    assert model.structure.parameters[0].nominal == pytest.approx(shared, rel=0.02)
    np.testing.assert_allclose(damping_of(model), list(TRUE.values()), rtol=0.02)
