"""How it is carried out: each stage narrows the one above (watchdog, preflight, runner, execution, handle, target)."""
