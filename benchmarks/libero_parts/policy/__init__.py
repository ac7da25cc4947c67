"""A policy trained on verified sessions on LIBERO: its skill, its training, its server."""
