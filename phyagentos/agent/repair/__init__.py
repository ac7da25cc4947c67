"""Graph repair: what follows when a session did not meet its objective. Paper section 4.2."""
