"""A fleet: one agent plane, targets on other hosts, NATS JetStream between them. Each workspace stays the truth."""
