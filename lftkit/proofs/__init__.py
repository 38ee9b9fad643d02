"""Guaranteed bounds with proofs and their checkers."""
