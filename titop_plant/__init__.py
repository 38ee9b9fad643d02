"""Model of the telescope: blocks, structures, the assembled spacecraft and its simulation."""
