"""Modal data of TITOP bodies from runs of NASTRAN: normal modes (BDF and OP2) and reduced matrices (punch files).

They need pyNastran (extra ``nastran``); nothing else of the package imports them.
"""

from titop_plant.nastran.interface import Interface
from titop_plant.nastran.matrices import read_nastran_matrices
from titop_plant.nastran.modes import nastran_mass, read_nastran

__all__ = ["Interface", "nastran_mass", "read_nastran", "read_nastran_matrices"]
