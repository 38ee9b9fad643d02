"""What is said of finished runs: metrics, verdicts, predictions, shares of the sources."""
