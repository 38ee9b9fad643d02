"""Models of lower order with a bound of what they lose: balanced truncation, with weights, of coprime factors."""

from lftkit.reduction.balanced import ReducedSystem, balred, hankel_singular_values, ncfmr

__all__ = ["ReducedSystem", "balred", "hankel_singular_values", "ncfmr"]
