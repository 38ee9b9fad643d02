"""Line of sight while the solar arrays turn.

python examples/paper/figure_solar_arrays_turn.py [FOLDER]
"""

import sys

from los_design.figures.plant_figures import draw_figures

for path in draw_figures(sys.argv[1] if len(sys.argv) > 1 else "figures", names=["arrays_turn"]):
    print(path)
