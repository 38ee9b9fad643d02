"""For every test: linear algebra on one thread, as the testbed runs it; two threads are slower on these sizes."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported; child processes inherit it
