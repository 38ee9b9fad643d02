"""Line of sight while the wheels speed up.

python examples/paper/figure_wheels_speed_up.py [FOLDER]
"""

import sys

from los_design.figures.plant_figures import draw_figures

for path in draw_figures(sys.argv[1] if len(sys.argv) > 1 else "figures", names=["wheels_speed_up"]):
    print(path)
