"""All figures of the paper, and the numbers beside them in results.json; or some of the figures.

python examples/paper/all.py [FOLDER] [--only NAME ...]
"""

import argparse
import json
from pathlib import Path

from paper_case import PaperCase
from paper_figures import FIGURES, draw
from paper_numbers import results

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("folder", nargs="?", type=Path, default=Path("figures"))
parser.add_argument("--only", nargs="+", choices=FIGURES, metavar="NAME", help=", ".join(FIGURES))
options = parser.parse_args()
case = PaperCase.of(Path(__file__).parent)
for path in draw(case, options.folder, options.only):
    print(path)
if options.only is None:
    path = options.folder / "results.json"
    path.write_text(json.dumps(results(case), indent=1) + "\n", "utf-8")
    print(path)
