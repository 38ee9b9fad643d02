"""Observer of the line of sight: its law at run time and its design problem."""
