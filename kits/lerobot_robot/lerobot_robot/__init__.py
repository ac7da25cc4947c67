"""Robots of LeRobot and its plug-ins as bodies of the kit; `python -m lerobot_robot` serves one."""
