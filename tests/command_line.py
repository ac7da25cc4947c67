"""The command line, called in this process."""

import sys
from collections.abc import Iterable
from dataclasses import dataclass

import pytest

from phyagentos.cli.app import main
from phyagentos.cli.outcome import ExitCode
from phyagentos.cli.reply import Reply
from phyagentos.operations import stop
from tests.published_results import check_printed, check_result, find_command


@dataclass(frozen=True)
class Result:
    code: int
    out: str
    err: str


def assert_ended(result: Result, code: int, *, out: Iterable[str] = (), err: Iterable[str] = ()) -> None:
    """It ended with this code, and each stream holds these words."""
    assert result.code == code, result.err
    assert [words for words in out if words not in result.out] == [], result.out
    assert [words for words in err if words not in result.err] == [], result.err


def assert_refused(result: Result, *said: str) -> None:
    """What was given is invalid input, and the command line says so in these words."""
    assert_ended(result, ExitCode.INVALID_INPUT, err=said)


@pytest.fixture
def paos(monkeypatch, capsys):
    monkeypatch.setattr(stop, "find_running", list)  # a test reaches no run of this machine but its own

    show = Reply.print

    def print_checked(reply, *, as_json):
        check_result(find_command(sys.argv[1:]), reply.found)
        return show(reply, as_json=as_json)

    monkeypatch.setattr(Reply, "print", print_checked)

    def call(*arguments: object) -> Result:
        monkeypatch.setenv("PAOS_DEBUG", "0")  # and forget what --debug sets
        monkeypatch.setattr(sys, "argv", ["paos", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        streams = capsys.readouterr()
        if "--json" in arguments:
            check_printed(find_command(arguments), streams.out)
        return Result(int(ended.value.code or 0), streams.out, streams.err)

    return call
