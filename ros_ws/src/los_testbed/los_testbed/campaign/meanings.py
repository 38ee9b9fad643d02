"""What the columns of metrics of a campaign are, in a few words, for tables."""

from __future__ import annotations

import re

MEANINGS = {
    "ape_max_arcsec": "largest absolute error [arcsec]",
    "ape_p997_arcsec": "absolute error, 99.7 % of the instants [arcsec]",
    "rpe_rms_mas": "relative error in windows of 20 ms, rms [mas]",
    "rpe_p997_mas": "relative error, 99.7 % of the instants [mas]",
    "ake_p997_arcsec": "absolute knowledge error, 99.7 % of the instants [arcsec]",
    "rke_rms_mas": "relative knowledge error, rms [mas]",
    "mirror_max_mrad": "largest mirror command [mrad]",
    "force_max_n": "largest force command [N]",
    "rpe_window_max_mas": "relative error, rms of the worst window [mas]",
    "rpe_window_p997_mas": "relative error, rms of a window, 99.7 % of the windows [mas]",
    "ape_effective": "independent samples of the absolute error",
    "rpe_window_effective": "independent windows",
    "ape_gain": "largest absolute error of a tone of unit norm over its limit",
    "slow_tone_mas": "relative error of the worst slow tone of unit norm [mas]",
    "fast_tone_mas": "relative error of the worst fast tone of unit norm [mas]",
    "rpe_fine_gain": "the larger of both over the limit of the stage with all actuators",
    "mirror_gain": "largest mirror angle of a tone of unit norm over its authority",
    "force_gain": "largest forces of a tone of unit norm over their authority",
    "noise_ape_arcsec_rms": "absolute error from sensor noise [arcsec rms]",
    "noise_rpe_mas_rms": "relative error from sensor noise [mas rms]",
    "total_mas": "what the required part of the windows keeps with the worst tone and the noise [mas]",
    "sensitivity_mirror": "peak sensitivity of the mirror loop",
    "sensitivity_forces": "peak sensitivity of the force loop",
    "rpe_peak_rad_s": "frequency of the worst tone [rad/s]",
}


def meaning(column: str) -> str:
    """Meaning of a column.

    Examples
    --------
    >>> meaning("rpe_window_above_25_mas")
    'share of the windows above 25 mas'
    >>> meaning("ape_p95_arcsec")
    'absolute error, 95 % of the instants [arcsec]'
    """
    stem, sign, limit = column.partition("_above_")
    quantile = re.fullmatch(r"(ape|rpe_window)_p(\d+)_(\w+)", column)
    if quantile and column not in MEANINGS:
        share, unit = 100 * float(f"0.{quantile[2]}"), quantile[3]
        if quantile[1] == "ape":
            return f"absolute error, {share:g} % of the instants [{unit}]"
        return f"relative error, rms of a window, {share:g} % of the windows [{unit}]"
    if sign:
        return f"share of the {'windows' if stem.endswith('window') else 'instants'} above {limit.replace('_', ' ')}"
    return MEANINGS.get(column, column.replace("_", " "))
