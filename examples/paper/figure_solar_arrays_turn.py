"""Line of sight while the solar arrays turn (paper: fig:tau_variation).

python examples/paper/figure_solar_arrays_turn.py [FOLDER]
"""

import sys
from pathlib import Path

from los_design.figures.paper_case import PaperCase
from los_design.figures.paper_figures import draw

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
for path in draw(PaperCase.of(Path(__file__).parent), folder, names=["solar_arrays_turn"]):
    print(path)
