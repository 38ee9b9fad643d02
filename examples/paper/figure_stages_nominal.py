"""The same of the nominal designs, which break the templates over the family (paper: dist2LOS_Nominal).

python examples/paper/figure_stages_nominal.py [FOLDER]
"""

import sys
from pathlib import Path

from los_design.figures.paper_case import PaperCase
from los_design.figures.paper_figures import draw

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
for path in draw(PaperCase.of(Path(__file__).parent), folder, names=["stages_nominal"]):
    print(path)
