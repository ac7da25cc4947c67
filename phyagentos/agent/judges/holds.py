"""The judge of what had to hold all through: "never spilled", "always upright", on the worst samples of the recorder.

Upstream: the contract's `hold` (constraints of the goal among them), and `holds.json`. Downstream: the verifier.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from phyagentos.agent.judges.judge import make_unknown
from phyagentos.protocol.evidence import HOLDS, Bundle
from phyagentos.protocol.verdicts import Criterion


@dataclass(frozen=True, slots=True)
class HoldJudge:
    """Judges conditions that had to hold all through, on the worst samples that the recorder kept."""

    name: str = "holds/1"

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion for each predicate of `hold`; one without a sample is unknown."""
        sampled = {criterion.text: criterion for criterion in bundle.holds}
        return [
            sampled.get(text) or make_unknown(text, "hold", HOLDS, "it was never sampled")
            for text in bundle.session.hold
        ]
