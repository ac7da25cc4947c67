"""Robots of LeRobot behind kits/lerobot_robot: servos that are emulated, and a plug-in that simulates its arm."""
