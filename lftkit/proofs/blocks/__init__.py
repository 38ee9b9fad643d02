"""Structures of uncertainty blocks: their matrices, balance, and perturbations that make a matrix singular."""
