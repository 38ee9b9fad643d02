"""Samples that were never sent: those of periods that a real-time loop has lost, as its recorder counted them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pointing_analysis.read.recording import Recording

UNSENT = "unsent_"
"""Statistics of the recorder: samples of a topic, whose absolute name is behind, that are missing and never were."""


def unsent(run: Recording, name: str) -> int:
    """Samples of a topic that are missing since nothing was sent in their periods; zero where nothing is said of it.

    Parameters
    ----------
    run : Recording
    name : str
        Topic without the namespace.
    """
    statistics = run.parameters.get("statistics")
    recorder = statistics.get("recorder") if isinstance(statistics, dict) else None
    found = recorder.items() if isinstance(recorder, dict) else ()
    texts = [str(text) for key, text in found if str(key).startswith(UNSENT) and str(key).endswith(f"/{name}")]
    return sum(int(text) for text in texts if text.isascii() and text.isdecimal() and len(text) < 16)
