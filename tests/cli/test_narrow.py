"""What a narrow terminal shows: words stay whole."""

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios

import pytest

from phyagentos.cli.outcome import fold


def read_terminal(*words, columns):
    """What `paos …` leaves on a terminal so wide, line by line, and how many letters each has."""
    near, far = pty.openpty()
    fcntl.ioctl(far, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
    kept = {name: value for name, value in os.environ.items() if name not in {"COLUMNS", "PYTEST_CURRENT_TEST"}}
    command = [sys.executable, "-m", "phyagentos", *words]
    with subprocess.Popen(command, stdin=far, stdout=far, stderr=far, env=kept) as process:
        os.close(far)
        shown = b""
        while data := _read(near):
            shown += data
        process.wait(60)
    os.close(near)
    return shown.decode().replace("\r", "").splitlines()


def _read(near):
    try:
        return os.read(near, 1 << 16)
    except OSError:  # the other end is closed
        return b""


@pytest.mark.parametrize(
    "words",
    [
        ("run", "tidy_tabel"),
        ("help", "slower"),
        ("-h",),
        ("codes", "UNKNOWN_NAME"),
        ("compile", "tidy_table"),
    ],
)
@pytest.mark.slow
def test_no_word_is_broken_on_sixty_columns(words):
    shown = read_terminal(*words, columns=60)
    assert shown
    assert [line for line in shown if len(line) > 60 and " " in line.strip() and "$ " not in line] == []


def test_lines_are_broken_between_words_and_keep_their_indent():
    assert fold("  one two three\nfour", 9) == "  one two\n  three\nfour"
    assert fold("a /path/that/is/longer/than/a/line b", 10) == "a\n/path/that/is/longer/than/a/line\nb"
    assert fold("as it is, whatever its length", 0) == "as it is, whatever its length"
