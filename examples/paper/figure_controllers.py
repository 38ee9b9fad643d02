"""Observer K_FSM beside the Kalman observer that it is tuned from, and K_PMA (paper: controllers).

python examples/paper/figure_controllers.py [FOLDER]
"""

import sys
from pathlib import Path

from los_design.figures.figures import draw

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
for path in draw(folder, 0, names=["controllers"]):
    print(path)
