"""The register: every sabotage of the gauntlet, in the order of the table."""

from tests.gauntlet.lies import execution, experience, records, safety, sensing, verdicts
from tests.gauntlet.sabotage import Sabotage

SABOTAGES: tuple[Sabotage, ...] = (
    *execution.SABOTAGES,
    *safety.SABOTAGES,
    *records.SABOTAGES,
    *sensing.SABOTAGES,
    *verdicts.SABOTAGES,
    *experience.SABOTAGES,
)
