"""Robot and scene models (MjSpec), shared by motion, perception and drivers."""
