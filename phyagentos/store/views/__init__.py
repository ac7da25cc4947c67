"""What people read: documents rendered from the truth, and read back where they are input too."""
