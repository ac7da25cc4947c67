"""Records of sessions: contract, lifecycle, evidence, verdicts, goals, stop signals."""
