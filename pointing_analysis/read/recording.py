"""Interface of a recording for the analysis: a bag of the testbed, any bag, a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from pointing_analysis.read.mcap.bag_loss import TopicLoss
from pointing_analysis.read.topic import Topic


class Recording(Protocol):
    """Topics as arrays, and what is known of the run.

    :class:`pointing_analysis.read.run.Run` (a bag of the testbed) and :class:`pointing_analysis.read.series.Series`
    (any other line of sight) have these members. The line of sight is the topic ``truth/los`` [rad]; ``parameters`` may
    be empty.
    """

    @property
    def path(self) -> Path:
        """File or folder, for messages."""

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Metadata of the run by the recorder."""

    @property
    def problems(self) -> tuple[str, ...]:
        """Defects, one sentence each."""

    @property
    def losses(self) -> tuple[TopicLoss, ...]:
        """Known losses, by topic."""

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Contradictions of the recording's own digests: with any, nothing is judged."""

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the topics, sorted."""

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Files in the recording, by name."""

    @property
    def title(self) -> str:
        """Short name for tables and figures."""

    def changed(self, parameters: Mapping[str, Any], attachments: Mapping[str, bytes]) -> Recording:
        """The same recording with other parameters and further attachments; the samples are shared."""

    @property
    def kind(self) -> str:
        """Type of the recording: ``bag``, ``CSV``, ``arrays`` ..."""

    def shown(self, name: str) -> str:
        """Name of a topic for messages; that of the columns where it comes from a table."""

    def __contains__(self, name: object) -> bool:
        """Whether the recording has a topic."""

    def __getitem__(self, name: str) -> Topic:
        """One topic."""
