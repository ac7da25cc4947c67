"""4. A judge: answers for one kind of criterion from evidence. Run me: python examples/04_judge.py"""

from collections.abc import Sequence

from phyagentos.judges import Bundle, Criterion, JudgeDefinition, JudgeSettings, Truth


class Haste:
    """Whether a session took at most so many control periods."""

    def __init__(self, settings: JudgeSettings) -> None:
        self.ticks_max = float(settings.options.get("ticks_max", 500.0))
        self.name = f"haste/1({self.ticks_max:g})"

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        ticks = bundle.execution.ticks
        truth = Truth.TRUE if ticks <= self.ticks_max else Truth.FALSE
        because = f"it took {ticks} control periods"
        return [Criterion(text="in time", kind="haste", truth=truth, evidence="execution.json", because=because)]


HASTE = JudgeDefinition(name="haste", open=Haste, description="Whether a session was in time.")

if __name__ == "__main__":
    import tempfile
    from pathlib import Path

    from phyagentos.testing import check_judge

    with tempfile.TemporaryDirectory() as folder:
        for criterion in check_judge(HASTE, Path(folder), ticks_max=5.0):
            print(f"{criterion.text}: {criterion.truth}, {criterion.because}")
