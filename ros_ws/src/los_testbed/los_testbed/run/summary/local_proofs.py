"""Bounds that a bag states as proven for its loop, compared with the local certificates.

A bag can state any bound. The certificates are looked up again, by the digests of the controllers in the bag and of the
telescope, with the settings and the statistics of the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from los_testbed.config.run_config import RunConfig, is_code
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.proven_loop import PROOF_KEYS, proof_of
from los_testbed.run.replay import models_of_controllers
from pointing_analysis.files.structured_text import load_yaml
from pointing_analysis.read.mcap.bag_metadata import value_of
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.guarantee import AS_STATED
from pointing_analysis.requirements.guarantee import METADATA as PROOF_BOUNDS
from pointing_analysis.requirements.summary import Summary

CONTROLLERS = ("k_fsm", "k_pma")
PARAMETERS_HASH = "parameters_hash"
AUTHORITIES = ("fsm_authority", "pma_authority")
ABOVE = 1.1
"""Part of a proven bound up to which a quantile of a record may be, which scatters."""


def confirmed(run: Run) -> frozenset[str]:
    """Keys of a bag's statements on proofs (`PROOF_KEYS`) that the local certificates confirm for its loop.

    None where the bag does not hold its configuration and controllers, or where the telescope's file is another now.
    """
    stated = {key: run.parameters[key] for key in PROOF_KEYS if run.parameters.get(key)}
    if not stated or "run.yaml" not in run.attachments:
        return frozenset()
    try:
        given = load_yaml(run.attachments["run.yaml"].decode(), "run.yaml of the bag")
        config = RunConfig.from_mapping(given)
        code = any(is_code(text) for name in CONTROLLERS if (text := getattr(config, name)))
        laws = None if code else models_of_controllers(run)
        parts = RunParts(config, laws)
        if parts.basis.parameters_hash != run.parameters.get(PARAMETERS_HASH) or not _agree(run, parts, given):
            return frozenset()
        found = {key: value_of(text) for key, text in proof_of(parts, _statistics(run, config)).items()}
    except (ValueError, TypeError, OSError, OverflowError):
        return frozenset()
    return frozenset(key for key, value in stated.items() if value == found.get(key))


def stated_lines(run: Run, lines: Mapping[str, str]) -> list[str]:
    """Lines by the keys of the statements that they are of; those of statements that are not confirmed say so."""
    known = confirmed(run) if any(lines.values()) else frozenset()
    return [text if not text or key in known else f"{AS_STATED}: {text}" for key, text in lines.items()]


def with_confirmed(run: Run, summary: Summary) -> Summary:
    """The summary of a run, whose bounds count as proven where they are :func:`confirmed`.

    Except a bound far below the record: it is not of the proven loop.
    """
    if not any(one.proven for one in summary.beside) or PROOF_BOUNDS not in confirmed(run):
        return summary
    beside = (
        one
        if one.proven is None or verdict.quantile.value > ABOVE * one.proven.value
        else replace(one, proven=replace(one.proven, checked=True))
        for one, verdict in zip(summary.beside, summary.verdicts)
    )
    return replace(summary, beside=tuple(beside))


def _agree(run: Run, parts: RunParts, given: Mapping[str, Any]) -> bool:
    """Whether the settings of a bag's metadata, by which it is shown, are those of its configuration `given`."""
    plain = {name: value for name, value in parts.config.to_plain().items() if name in given}
    limits = {name: getattr(parts.basis, name) for name in AUTHORITIES}
    return all(run.parameters.get(name) == value for name, value in {**plain, **limits}.items())


def _statistics(run: Run, config: RunConfig) -> dict[str, dict[str, str]]:
    """Statistics of each node; of a plant that is an object of a program its name is beside them in the bag."""
    recorded: Any = run.parameters.get("statistics")
    tables = recorded.items() if isinstance(recorded, dict) else ()
    found = {str(k): {str(n): str(v) for n, v in table.items()} for k, table in tables if isinstance(table, dict)}
    name = str(run.parameters.get("plant") or "")
    if name != str(config.plant or ""):
        found.setdefault("plant", {})["plant"] = name
    return found
