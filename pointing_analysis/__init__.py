"""From a recorded run to a pointing verdict.

=================  ====================================================================================
`read`             ``Run.open(path)``: a bag as arrays; `topic`: one topic and its gaps
`errors`           performance and knowledge error of a run, start-up transient dropped
`metrics`          APE, MPE, RPE, PDE, PRE; `weights`: their spectral weights
`confidence`       quantiles with confidence bounds; `spectra`: densities and disturbance lines
`image`            pupil, transfer of the motion, Strehl ratio, encircled energy, ellipticity of each exposure
`requirements`     the verdict on requirements, `requirement_text` their form; `budget`: error budgets
`tone_budget`      noise, slow and fast tones of the relative error beside their allowances
`requirement_rows` what every table says of a verdict
`summary`          the metrics of a run; `report`: the HTML page, `report_cards`,
                   `figures`, `cumulative_figure`, `inline_svg` and `prediction`: its parts
`replay`           recorded sensors through observers and controllers; `gap_stepping`: over missed ticks
`series`           any arrays; `los_source`: any file; `external_bag`, `ros_definitions`, `tables`: their formats
`budget_file`      budgets as a tree of `budget_sources`; `budget_total`: totals; `budget_page`: their page
`bag_pass`         one pass over a bag, `Run` and `--los` alike
`cdr`              messages as bytes; `message_types`: names and definitions; `mcap_records`: the file format
`mcap_walk`        one pass over a file, also a damaged one; `bag_loss`: what it lacks
`dataframes`       topics as pandas or xarray objects
`synthetic`        bags with known answers
=================  ====================================================================================
"""
