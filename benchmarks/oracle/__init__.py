"""What was achieved in a recorded world, by MuJoCo and numpy alone: nothing of the package acts or judges here."""
