"""Line of sight and relative error of the four stages over the family, robust design (paper: closed loop, dist2LOS).

python examples/paper/figure_stages_robust.py [FOLDER [SAMPLES]]

SAMPLES random members of the family beside the worst ones of each stage; each takes some seconds.
"""

import sys
from pathlib import Path

from los_design.figures.figures import draw

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
for path in draw(folder, int(sys.argv[2]) if len(sys.argv) > 2 else 2, names=["stages_implemented"]):
    print(path)
