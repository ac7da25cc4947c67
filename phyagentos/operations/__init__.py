"""Use cases, one module each: typed arguments in, a frozen struct out; what is printed or asked is the caller's."""
