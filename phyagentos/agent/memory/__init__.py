"""Epistemic memory: episodes, what they show, what was verified to help, how it is found again. Paper section 4.3."""
