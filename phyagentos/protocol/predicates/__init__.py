"""One small language for what must hold: syntax, evaluation on snapshots, and the predicates that ship."""
