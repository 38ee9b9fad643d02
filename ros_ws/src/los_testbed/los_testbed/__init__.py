"""ROS 2 testbed for fine line-of-sight control: nodes, runs, bags, command line.

``__version__`` is the version of the distribution, written down here alone.
"""

__version__ = "0.2.0"
