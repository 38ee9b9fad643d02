"""The command line: one file for each command.

Linear algebra is on one thread, as in the nodes: the variable is read when numpy is imported, which this comes before.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
