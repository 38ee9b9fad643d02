"""ROS 2 nodes, thin over the cores: bytes to arrays, ``core.step``, arrays to bytes."""
