"""``python -m los_testbed`` is the command ``los-testbed``."""

from los_testbed.program import main

if __name__ == "__main__":
    raise SystemExit(main())
