"""Line of sight of the four configurations over the family, robust designs (paper: dist2LOS).

python examples/paper/figure_stages_robust.py [FOLDER]
"""

import sys
from pathlib import Path

from los_design.figures.paper_case import PaperCase
from los_design.figures.paper_figures import draw

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
for path in draw(PaperCase.of(Path(__file__).parent), folder, names=["stages_robust"]):
    print(path)
