"""The small telescope of tests/support stands in for the plant."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
import os

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # message fields are type-checked in tests
