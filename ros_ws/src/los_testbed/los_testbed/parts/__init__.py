"""What a run is made of: telescope, controllers, start, sources of disturbance, plant."""
