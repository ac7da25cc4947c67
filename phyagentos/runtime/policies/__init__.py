"""Policy servers: messages, transports, and the skill runtime that carries out their actions."""
