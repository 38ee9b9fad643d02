"""Payload mounted hard and on its isolator.

python examples/paper/figure_isolator.py [FOLDER]
"""

import sys

from los_design.figures.plant_figures import draw_figures

for path in draw_figures(sys.argv[1] if len(sys.argv) > 1 else "figures", names=["isolator"]):
    print(path)
