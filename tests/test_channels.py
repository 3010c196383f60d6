"""channels.toml: every key means what docs/formats.md says, and a wrong one is named."""

from pathlib import Path

import numpy as np
import pytest

from labnnum.errors import ChannelError, ConfigError, FileError, UnitError
from labnnum.recording import Channel
from sessions.channels import parse_channels, read_channels

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "recordings"


def one(text, head="sample_rate = 10\n"):
    (stored,) = parse_channels(f'{head}[[channel]]\nname = "a"\n{text}').stored()
    return stored


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*/*channels.toml")), ids=lambda p: f"{p.parent.name}/{p.name}")
def test_the_examples_use_every_key_right(path):
    told = read_channels(path)
    assert told.unused() == []
    assert told.stored()


@pytest.mark.parametrize(
    ("text", "quantity"),
    [
        ("", "acceleration"),
        ('role = "reference"', "force"),
        ('unit = "lbf"', "force"),
        ('unit = "mm"', "displacement"),
        ('unit = "g"', "acceleration"),
        ('unit = "N"\nquantity = "force"\nrole = "response"', "force"),
        ('unit = "mV"\nsensitivity = 0.1', "acceleration"),
    ],
)
def test_the_unit_or_the_role_tells_the_quantity(text, quantity):
    assert one(text).channel.quantity == quantity


def test_place():
    assert one('node = "3:-z"').channel == Channel("a", node="3", direction="-z")
    assert one('node = 3\ndirection = "+rx"').channel.dof == "3:rx"
    assert one('node = "left: top"\ndirection = "y"').channel.dof == "left: top:y"


def test_sensitivity_makes_volts_of_the_samples():
    kept = one('unit = "g"\nsensitivity = 0.1\nfull_scale = 5')
    assert (kept.raw_unit, kept.full_scale) == ("V", 5)
    assert kept.channel.sensitivity == pytest.approx(0.1 / 9.80665)
    assert kept.to_si(np.array([0.2]))[0] == pytest.approx(2 * 9.80665)
    assert one('unit = "mV"\nsensitivity = "100 mV/g"').raw_unit == "mV"


def test_offset_is_subtracted_in_the_unit_of_the_file():
    assert one('unit = "mm"\noffset = 3.0').to_si(np.array([4.0]))[0] == pytest.approx(1e-3)
    assert one('quantity = "temperature"\nunit = "degC"').to_si(np.array([20.0]))[0] == pytest.approx(293.15)


def test_keys_of_others_are_kept_aside_and_misspelt_ones_refused():
    told = parse_channels('title = "x"\n[bench]\nroom = 3\n[[channel]]\nname = "a"\nserial = 7\n')
    assert told.unused() == ["title", "bench", "channel[1].serial"]
    assert parse_channels('[[channels]]\nname = "a"\n').stored()[0].channel.name == "a"


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("sample_rate = 10", ConfigError, "channel is missing"),
        ('[[channel]]\nname = ""', ConfigError, r"channel\[1\]\.name"),
        ('perod = 3\n[[channel]]\nname = "a"', ConfigError, "perod is no key; did you mean 'period'"),
        ('[[channel]]\nname = "a"\ndirection = "w"', ChannelError, "direction 'w' is not one of"),
        ('[[channel]]\nname = "a"\nquantity = "strength"', ConfigError, "'strength' is not one of force"),
        ('[[channel]]\nname = "a"\nunit = "parsnip"', UnitError, r"channel\[1\]: channel 'a': unit 'parsnip'"),
        ('[[channel]]\nname = "a"\n[[channel]]\nname = "a"', ConfigError, "two channels are named 'a'"),
        ('sample_rate = inf\n[[channel]]\nname = "a"', ConfigError, "must be a positive number"),
        ('period = -1\n[[channel]]\nname = "a"', ConfigError, r"period: must be greater than or equal to 0"),
        ('[[channel]]\nname = "a"\n[frf]\n[[frf.row]]\noutput = "a"\ninput = "b"\nreal = 1', ConfigError, "needs val"),
        ('[[channel]]\nname = "a"\n[[run]]\nstart = "x"', ConfigError, r"run\[1\]\.start"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(text, error, words):
    with pytest.raises(error, match=words) as caught:
        parse_channels(text).stored()
    assert str(caught.value).startswith("channels.toml: ")
    assert "\n" not in str(caught.value)


def test_files_that_are_no_text(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        read_channels(tmp_path / "none.toml")
    (tmp_path / "x.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileError, match="is not UTF-8"):
        read_channels(tmp_path / "x.toml")
