"""What targets, skills and policies can do, as authored files and documents."""
