"""For every test: linear algebra on one thread, as the testbed runs it; no time limit per hypothesis example."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported; child processes inherit it

from hypothesis import settings

settings.register_profile("any-machine", deadline=None)  # a test must not depend on the speed of the machine
settings.load_profile("any-machine")
