"""Skill runtimes: what turns a session into commands."""
