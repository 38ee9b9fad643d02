"""Flight code in C99, bit-identical to the testbed: observer, mirror law, proof-mass law and command gates."""
