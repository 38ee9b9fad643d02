"""Tables of a parameter file: what is mounted on the body, and moving parts of wheels and drives."""
