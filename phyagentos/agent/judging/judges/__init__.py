"""Judges: each reads an evidence bundle and answers with criteria; the verifier composes them. Paper section 4.2."""
