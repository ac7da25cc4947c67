"""Exchanges with servers that may be slow or hostile; both planes have clients of such."""
