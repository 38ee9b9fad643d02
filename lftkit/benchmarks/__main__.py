"""``python -m lftkit.benchmarks norms|responses|tuning``."""

from lftkit.benchmarks.command_line import main

if __name__ == "__main__":
    main()
