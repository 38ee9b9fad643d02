"""Sources of disturbance at named places of the structure: measured series, harmonics, spectra, coolers, pulses."""
