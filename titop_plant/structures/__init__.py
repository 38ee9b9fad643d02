"""Structures: beam frames and finite-element results reduced to modal data of TITOP bodies."""

from titop_plant.structures.beam_element import Section
from titop_plant.structures.beam_frame import Beam, BeamFrame, LumpedMass, to_modal_data
from titop_plant.structures.mass_summary import MassProperties, MassSummary, mass_summary
from titop_plant.structures.modal_data import ChildPort, ModalData, from_inertia
from titop_plant.structures.modal_file import read_modal_data, write_modal_data
from titop_plant.structures.residual_mass import (
    ResidualMode,
    ResidualRepair,
    add_residual_modes,
    check_residual_mass,
    effective_masses,
    repair_residual_mass,
    smallest_residual_fraction,
)
from titop_plant.structures.visibility import port_visibility

__all__ = [
    "Beam",
    "BeamFrame",
    "ChildPort",
    "LumpedMass",
    "MassProperties",
    "MassSummary",
    "ModalData",
    "ResidualMode",
    "ResidualRepair",
    "Section",
    "add_residual_modes",
    "check_residual_mass",
    "effective_masses",
    "from_inertia",
    "mass_summary",
    "port_visibility",
    "read_modal_data",
    "repair_residual_mass",
    "smallest_residual_fraction",
    "to_modal_data",
    "write_modal_data",
]
