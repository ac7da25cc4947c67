"""Supervision of targets: queues, leases, limits, liveness, recorded state changes."""
