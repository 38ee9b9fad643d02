"""The plant of a run in coordinates in which its modes are apart, made once for all that a run needs of it.

Step matrices, tones, steady state and responses are cheap in these coordinates (:mod:`lftkit.analysis.modal_form`);
the decomposition is what costs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from lftkit import System
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.modal_form import ModalForm
from lftkit.arrays import FloatArray
from titop_plant.interface import COMMANDS


@dataclass(frozen=True)
class ModalPlant:
    """A plant at given parameter values: ``x = form.basis q``, ``q' = L q + excited u``, ``y = observed q + D u``.

    Parameters
    ----------
    form : ModalForm
        Its coordinates, order n.
    excited : ndarray, shape (n, 30)
        What commands (8) and disturbances (22) add to ``q'``.
    observed : ndarray, shape (24, n)
        Measurements (22) and truth (2).
    D : ndarray, shape (24, 30)
    """

    form: ModalForm
    excited: FloatArray
    observed: FloatArray
    D: FloatArray

    @classmethod
    def of(cls, data: System) -> ModalPlant:
        """Of a continuous plant; those of the last plants are kept, since a run needs one for start and simulation.

        Parameters
        ----------
        data : System
            Inputs: commands (8), disturbances (22); outputs: measurements (22), truth (2).

        Raises
        ------
        ArithmeticError
            The eigenvalues of the plant did not converge.
        """
        return _modal_plant(*((matrix.tobytes(), matrix.shape) for matrix in data.matrices))

    @property
    def order(self) -> int:
        """Number of states n."""
        return self.form.order

    @cached_property
    def response(self) -> FrequencyResponse:
        """From the disturbances to measurements and truth, shape (24, 22)."""
        disturbances = slice(COMMANDS, None)
        return FrequencyResponse.of_modal_form(
            self.form, self.excited[:, disturbances], self.observed, self.D[:, disturbances]
        )


@lru_cache(maxsize=4)
def _modal_plant(*contents: tuple[bytes, tuple[int, int]]) -> ModalPlant:
    A, B, C, D = (np.frombuffer(content).reshape(shape) for content, shape in contents)
    form = ModalForm.of(A)
    return ModalPlant(form, form.excited(B), form.observed(C), D)


__all__ = ["ModalPlant"]
