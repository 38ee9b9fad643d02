"""Image quality from the line of sight: what the telescope sees of a star while its line of sight moves."""
