"""Disturbances: tones of wheels and array drives, and sources at named places of the structure.

A scenario of a run is a set of tones (:mod:`~titop_plant.disturbances.wheel_and_drive_tones`,
:mod:`titop_plant.simulation.scenarios`). A source has a place (:mod:`~titop_plant.disturbances.places`) and a signal
(:mod:`~titop_plant.disturbances.signals`): measured series, harmonics, waterfall, spectrum, cooler, pulses. A new kind
of source is a signal and a row of ``KINDS`` in :mod:`titop_plant.disturbances.source_kinds`; files of sources are read
by :mod:`los_testbed.parts.disturbance_files`.
"""
