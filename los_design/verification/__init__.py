"""Verification and certification of designs."""
