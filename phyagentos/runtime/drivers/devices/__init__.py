"""Drivers of real robots: one for all joints behind a bus, and a bus a vendor."""
