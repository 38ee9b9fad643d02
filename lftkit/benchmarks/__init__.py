"""Speed and results of this library beside others, on the user's machine: ``python -m lftkit.benchmarks``."""
