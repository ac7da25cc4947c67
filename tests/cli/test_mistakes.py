"""Mistakes of new users: every message says what, where, found, expected and what to do next."""

import re
import shutil
from pathlib import Path
from statistics import mean

import pytest
import yaml

from phyagentos.cli.outcome import ExitCode

ROOT = Path(__file__).resolve().parents[2]
MISTAKES, OF_VALUES, OF_NAMES = (
    yaml.safe_load((Path(__file__).parent / name).read_text(encoding="utf-8"))
    for name in ("mistakes.yaml", "mistakes_of_values.yaml", "mistakes_of_names.yaml")
)
LIBRARY_WORDS = re.compile(
    r"Input should|Field required|Value error|Tuple should|\w+Error\b|Traceback|pydantic|msgspec|`float`|type float"
    r"|mapping values|could not find|did not find|cannot start|found unexpected|undefined alias|constructor"
)
BESIDE = ("protocol/", "robots/")  # where files stand beside each other
MOST = 3.0


def make_mistake(mistake: dict, root: Path) -> tuple[Path, str]:
    """The edited file, and the address `file:line:column` of its problem."""
    path = root / mistake["file"]
    path.parent.mkdir(parents=True, exist_ok=True)
    for sibling in (ROOT / mistake["file"]).parent.iterdir() if mistake["file"].startswith(BESIDE) else ():
        if sibling.is_file():
            shutil.copyfile(sibling, path.parent / sibling.name)
    before = (ROOT / mistake["file"]).read_text(encoding="utf-8")
    assert mistake["old"] in before
    text = before.replace(mistake["old"], mistake["new"], 1)
    path.write_text(text, encoding="utf-8")
    head = text[: text.index(mistake["at"])]
    return path, f"{path}:{head.count(chr(10)) + 1}:{len(head) - head.rfind(chr(10))}"


def rate(err: str, mistake: dict, address: str) -> float:
    """0 to 3 points for what, where, found, expected and next of the best line; 0 for a library's own wording."""
    if LIBRARY_WORDS.search(err):
        return 0.0
    return max((rate_line(line, mistake, address) for line in err.splitlines()), default=0.0)


def rate_line(line: str, mistake: dict, address: str) -> float:
    """Found, expected and next count where they stand in this order, in parts of their own."""
    _, _, told = line.partition(f": {mistake['code']}: found ")
    found, _, rest = told.partition("; expected ")
    parts = [
        f": {mistake['code']}" in line,
        line.startswith(f"{address}: "),
        mistake["found"] in found,
        mistake["expected"] in rest,
        mistake["next"] in rest.replace(mistake["expected"], "", 1),
    ]
    return MOST * sum(parts) / len(parts)


def make_and_rate(paos, mistake: dict, root: Path) -> tuple[float, str]:
    path, address = make_mistake(mistake, root)
    command = ("run", mistake["run"], "-w", root / "w", "--faults", path) if "run" in mistake else ("lint", path)
    result = paos(*command)
    assert result.code == ExitCode.INVALID_INPUT, result
    assert not (root / "w").exists()
    return rate(result.err, mistake, address), result.err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mistakes", "count", "least_mean"), [(MISTAKES, 40, 2.7), (OF_VALUES, 144, 3.0), (OF_NAMES, 44, 3.0)]
)
def test_mistakes_are_told_with_their_place_and_words(mistakes, count, least_mean, paos, tmp_path):
    assert len(mistakes) == count
    ratings, poor = [], []
    for index, mistake in enumerate(mistakes):
        rating, err = make_and_rate(paos, mistake, tmp_path / str(index))
        ratings.append(rating)
        poor += [f"{rating:.1f} {mistake['mistake']}: {err}"] if rating < MOST else []
    assert min(ratings) > 0.0, "\n".join(poor)
    assert mean(ratings) >= least_mean, "\n".join(poor)


def test_the_rating_can_fail(tmp_path):
    mistake = MISTAKES[0]
    _, address = make_mistake(mistake, tmp_path)
    assert rate("", mistake, address) == 0.0
    assert (
        rate(f"{address}: INVALID_VALUE: found [0.82, 0.16, 0.14]; expected Input should be a tuple", mistake, address)
        == 0.0
    )
    assert rate(f"{address}: INVALID_VALUE", mistake, address) == pytest.approx(1.2)
    assert (
        rate(f"{address}: INVALID_VALUE: found [0.82, 0.16, 0.14]; expected 4 values. Add 1.", mistake, address) == 3.0
    )
