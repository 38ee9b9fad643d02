"""A pointing error budget after ECSS-E-ST-60-10C with one measured contribution.

python examples/pointing_budget.py
"""

import numpy as np

from pointing_analysis.budget.lines import combine, contribution, periodic, uniform

# arcsec, about x and y
contributions = [
    contribution("star tracker noise", [1.0, 1.0]),
    contribution("alignment, within 0.5", uniform([0.5, 0.5]), within_exposure=False),
    contribution("thermal bending", periodic([0.8, 0.3]), within_exposure=False),
    contribution("jitter, measured in a run", [0.017, 0.021]),
]
for index in ("APE", "RPE"):
    total = combine(contributions, index, factor=2.0)
    print(f"{index}: {np.round(total.level, 3)} arcsec at 95 %")
