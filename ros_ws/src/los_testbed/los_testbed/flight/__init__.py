"""The laws that fly as C99: observer, mirror law, proof-mass law and command gates, with the bits of the testbed."""
