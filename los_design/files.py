"""Names of the files in a folder of designs."""

CONTROLLERS = {"k_fsm": "k_fsm.json", "k_pma": "k_pma.json"}
"""K_FSM and K_PMA, by the settings of a run that name such files."""

TELESCOPE = "telescope.toml"
"""Parameter file of the telescope that the controllers were made for; without one it is the reference telescope."""

WORST_POINTS = "worst_points.json"
"""Worst parameter values of each stage."""

VERIFICATION = "verification.json"
"""Gammas, margins and what is not met."""

ROUNDS = "rounds.json"
"""State of a design between its rounds; it stays where the wall limit ended the design, which can then be resumed."""

BOUNDS = "bounds.json"
"""Bounds of the figures that were to be proven."""
