"""Motion as pure functions: kinematics (mink), collision, paths (OMPL), timing (toppra), shaping (casadi), grasps."""
