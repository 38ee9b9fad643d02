"""ROS 2 nodes: messages to arrays, one step of the plant, the observer or the controller, arrays to messages."""
