"""What the status of a verdict says of its requirement."""

from __future__ import annotations

MET = {"compliant": True, "not compliant": False}
"""Whether a requirement is met, by the status of a verdict; others demonstrate nothing."""
