"""Bounds of uncertain systems over the frequency axis by scalings that depend on frequency, with a proof.

For systems of more states and parameters than :mod:`lftkit.proofs.state_space` can take.
"""
