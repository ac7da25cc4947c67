"""The command line, called in this process."""

import sys
from dataclasses import dataclass

import pytest

from phyagentos.cli.app import main
from phyagentos.cli.outcome import ExitCode
from phyagentos.operations import stop


@dataclass(frozen=True)
class Result:
    code: int
    out: str
    err: str


def assert_refused(result: Result, *said: str) -> None:
    """What was given is invalid input, and the command line says so in these words."""
    assert result.code == ExitCode.INVALID_INPUT, result.err
    assert [words for words in said if words not in result.err] == [], result.err


@pytest.fixture
def paos(monkeypatch, capsys):
    monkeypatch.setattr(stop, "find_running", list)  # a test reaches no run of this machine but its own

    def call(*arguments: object) -> Result:
        monkeypatch.setenv("PAOS_DEBUG", "0")  # and forget what --debug sets
        monkeypatch.setattr(sys, "argv", ["paos", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        streams = capsys.readouterr()
        return Result(int(ended.value.code or 0), streams.out, streams.err)

    return call
