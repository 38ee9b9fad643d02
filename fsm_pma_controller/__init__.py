"""Controller of the mirror and of the proof-mass actuators: its law at run time and its design problem."""
