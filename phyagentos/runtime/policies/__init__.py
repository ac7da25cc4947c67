"""Policy servers: what is said to them, over which wire, and the skill runtime that carries out what they answer."""
