"""The MuJoCo driver: simulated physics, sensors, faults and target-local limits."""
