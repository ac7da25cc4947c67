"""Verified goals as a ROS 2 action: a node in the Python of a ROS distribution; phyagentos in other processes."""
