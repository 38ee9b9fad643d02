"""Parts of a run: telescope, controllers, start, disturbance sources, plant."""
