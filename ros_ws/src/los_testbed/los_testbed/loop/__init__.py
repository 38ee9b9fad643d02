"""The loop without ROS: simulation, joining by stamp, gate, clock, statistics of time."""
