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


@dataclass(frozen=True)
class ModalPlant:
    """A plant at given parameter values: ``x = form.basis q``, ``q' = L q + excited u``, ``y = observed q + D u``.

    Parameters
    ----------
    form : ModalForm
        Its coordinates, order n.
    excited : ndarray, shape (n, c + d)
        What c commands and d disturbances add to ``q'``.
    observed : ndarray, shape (m + 2, n)
        m measurements and truth (2).
    D : ndarray, shape (m + 2, c + d)
    commands : int
        Their number c.
    """

    form: ModalForm
    excited: FloatArray
    observed: FloatArray
    D: FloatArray
    commands: int

    @classmethod
    def of(cls, data: System, commands: int) -> ModalPlant:
        """Of a continuous plant; those of the last plants are kept, since a run needs one for start and simulation.

        Parameters
        ----------
        data : System
            Inputs: commands, disturbances; outputs: measurements, truth (2).
        commands : int
            Number of commands.

        Raises
        ------
        ArithmeticError
            The eigenvalues of the plant did not converge.
        """
        return _modal_plant(commands, *((matrix.tobytes(), matrix.shape) for matrix in data.matrices))

    @property
    def order(self) -> int:
        """Number of states n."""
        return self.form.order

    @cached_property
    def response(self) -> FrequencyResponse:
        """From the disturbances to measurements and truth, shape (m + 2, d)."""
        disturbances = slice(self.commands, None)
        return FrequencyResponse.of_modal_form(
            self.form, self.excited[:, disturbances], self.observed, self.D[:, disturbances]
        )


@lru_cache(maxsize=4)
def _modal_plant(commands: int, *contents: tuple[bytes, tuple[int, int]]) -> ModalPlant:
    A, B, C, D = (np.frombuffer(content).reshape(shape) for content, shape in contents)
    form = ModalForm.of(A)
    return ModalPlant(form, form.excited(B), form.observed(C), D, commands)


__all__ = ["ModalPlant"]
