"""Look-ahead: a session carried out in the imagination, many times, before a motor moves."""
