"""Models of lower order with a bound of what they lose: balanced truncation, with weights, of coprime factors."""

from typing import TYPE_CHECKING

from lftkit.support.on_demand import names_on_demand

if TYPE_CHECKING:
    from lftkit.reduction.balanced import ReducedSystem, balred, hankel_singular_values, ncfmr

__all__ = ["ReducedSystem", "balred", "hankel_singular_values", "ncfmr"]

__getattr__ = names_on_demand(__name__, {"balanced": ("ReducedSystem", "balred", "hankel_singular_values", "ncfmr")})
