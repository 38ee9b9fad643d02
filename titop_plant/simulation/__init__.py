"""The telescope in time: disturbances, profiles, sampled plant."""
