"""All figures of the paper, and the numbers beside them in results.json.

python examples/paper/all.py [FOLDER]
"""

import json
import sys
from pathlib import Path

from los_design.figures.paper_case import PaperCase
from los_design.figures.paper_figures import draw
from los_design.figures.paper_numbers import results

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
case = PaperCase.of(Path(__file__).parent)
for path in draw(case, folder):
    print(path)
path = folder / "results.json"
path.write_text(json.dumps(results(case), indent=1) + "\n", "utf-8")
print(path)
