"""From a request in words to a goal: what is wanted, what has to be asked back, what cannot be done here."""
