"""One bounded, typed context for every call of a model, and for `paos context`. Paper section 3.4 (ContextBuilder)."""
