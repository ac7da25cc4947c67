"""The worker process of one target: orders, runner, recorder, heartbeat."""
