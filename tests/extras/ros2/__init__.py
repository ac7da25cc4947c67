"""A robot that is reachable over ROS 2 alone: MuJoCo behind a controller's topics, cameras, a clock and a stop."""
