"""Wheel imbalance and drive torque to line of sight, nominal and over the family (paper: fig:dist2LOS).

python examples/paper/figure_disturbances_to_los.py [FOLDER]
"""

import sys
from pathlib import Path

from los_design.figures.paper_case import PaperCase
from los_design.figures.paper_figures import draw

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
for path in draw(PaperCase.of(Path(__file__).parent), folder, names=["disturbances_to_los"]):
    print(path)
