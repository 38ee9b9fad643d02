"""Structures of controllers: what is tuned, what is fixed, and within which bounds."""
