"""The loop without ROS: simulation, synchronization by stamp, command gate, tick clock, scheduling, latency, health."""
