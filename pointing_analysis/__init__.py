"""From a recorded run to a pointing verdict.

=================  ====================================================================================
`read`             ``Run.open(path)``: a bag as arrays; `topic`: one topic and its gaps
`errors`           performance and knowledge error of a run, start-up transient dropped
`metrics`          APE, MPE, RPE, PDE, PRE; `weights`: their spectral weights
`statistics`       quantiles with confidence bounds; `spectra`: densities and disturbance lines
`requirements`     requirements in text form and the verdict on them; `budget`: error budgets
`summary`          the figures of a run; `report`: the HTML page
`replay`           recorded sensors through observers and controllers
`synthetic`        bags with known answers
=================  ====================================================================================
"""
