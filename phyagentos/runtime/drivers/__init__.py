"""Target drivers; each implements the port in `runtime.targets`."""
