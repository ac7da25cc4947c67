"""A ROS 2 robot as a target of phyagentos: topics of its controllers, cameras and stop, named in `ros2.yaml`."""
