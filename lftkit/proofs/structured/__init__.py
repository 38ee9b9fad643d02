"""The structured singular value: bounds of a matrix from both sides, with a certificate that separate code checks."""
