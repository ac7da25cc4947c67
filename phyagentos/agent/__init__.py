"""What should be done: goals become sessions, evidence becomes verdicts, verdicts become repairs."""
