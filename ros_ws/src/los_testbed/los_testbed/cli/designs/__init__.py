"""Commands on controllers: design, proofs, export."""
