"""Results of finished runs: metrics, verdicts, predictions, shares of the sources."""
