"""Spectra of the error and the tones in it."""
