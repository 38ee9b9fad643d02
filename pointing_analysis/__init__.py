"""From a recorded run to a pointing verdict.

Each folder imports itself and the folders above it, never one below.

================  =====================================================================================
`files`           outputs that appear whole or not at all; text files of others with limits
`read`            ``run.Run.open(path)``: a bag as arrays; tables and bags of others; `series`: any arrays
`replay`          recorded sensors through observers and controllers, also over missed ticks
`indices`         performance and knowledge error, APE, MPE, RPE, PDE, PRE, confidence bounds, synthetic bags
`spectra`         densities, disturbance lines, predicted and measured tones, budget of a run's tones
`image`           pupil, transfer of the motion, Strehl ratio, encircled energy, ellipticity of each exposure
`requirements`    `text`: their form; `verdict` on each; `rows` of every table; `summary` of a run
`budget`          pointing error budgets: sources, files, totals
`report`          HTML pages of runs and of budgets, and their pictures
`command`         what commands share; ``pointing-analysis analyse``, without the testbed
================  =====================================================================================
"""

__version__ = "0.2.0"
