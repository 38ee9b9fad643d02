"""Wheel imbalance and drive torque to line of sight, nominal and over the family (paper: dist2LOS).

python examples/paper/figure_disturbances_to_los.py [FOLDER]
"""

import sys

from los_design.figures.plant_figures import draw_figures

for path in draw_figures(sys.argv[1] if len(sys.argv) > 1 else "figures", names=["wheels_and_drives"]):
    print(path)
