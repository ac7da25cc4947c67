"""Parts of the suite `unseen`: rooms, goals and faults, what is feasible, and what came of it."""
