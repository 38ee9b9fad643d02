"""A rig instead of the simulated telescope: contract, supervision, the reference driver over UDP, its emulator."""
