"""The leaves that ship, one behaviour a file."""
