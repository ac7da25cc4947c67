"""The page: a workspace in the browser, read from its documents before, during or after a run."""
