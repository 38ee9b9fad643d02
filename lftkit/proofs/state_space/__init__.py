"""Bounds of uncertain systems by cells of parameters and frequency, with a proof.

Start at :func:`lftkit.proofs.worst_case_gain`.
"""
