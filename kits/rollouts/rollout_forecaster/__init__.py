"""Look-ahead by simulation: a session is rehearsed in the believed world, then played in many drawn around it."""
