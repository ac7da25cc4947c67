"""Verdicts of phyagentos on what any ROS 2 robot did, published beside the programs that move it."""
