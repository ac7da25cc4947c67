"""All mutants, in the order of the table."""

from tests.mutants.claims import execution, experience, records, safety, sensing, verdicts
from tests.mutants.mutant import Mutant

ROOMS = (execution, safety, records, sensing, verdicts, experience)
MUTANTS: tuple[Mutant, ...] = tuple(mutant for room in ROOMS for mutant in room.MUTANTS)
