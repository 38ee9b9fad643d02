"""Pictures of tuned designs."""
