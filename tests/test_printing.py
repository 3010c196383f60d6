"""What commands print while they work."""

import pytest

from sessions.commands import printing


@pytest.mark.parametrize(("every", "said"), [(0.0, ["reading on", "locating"]), (1e9, [])])
def test_without_a_terminal_a_long_command_tells_where_it_is(capsys, monkeypatch, every, said):
    monkeypatch.setattr(printing, "SPARSE", every)
    with printing.stages("reading") as tell:
        tell("reading on")
        tell("locating")
    out, err = capsys.readouterr()
    assert out == ""
    assert [line.split(": ", 2)[2] for line in err.splitlines()] == said
