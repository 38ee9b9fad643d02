"""Closed-loop gains and exact values with gradients."""
