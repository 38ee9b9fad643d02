"""Control design of the whole loop: synthesis, sampled loop, verification, stored designs, figures. No ROS."""
