"""Motion as pure functions: kinematics, collision, paths, timing (TOPP-RA), shaping (casadi), grasps."""
