"""Settings of a run: what a ROS parameter and the metadata of a bag can hold.

ROS parameters and the metadata of bags have no word for what is absent: :meth:`Settings.to_plain` writes ``""``, ``0``,
``-1`` or an empty list or mapping in its place, and these are read as absent. Fields, checks and messages are those of
:mod:`pointing_analysis.files.settings`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import ValidationInfo, field_validator
from pydantic.dataclasses import dataclass

from lftkit.errors import InputError
from lftkit.support.structured_text import load_json
from pointing_analysis.files.settings import (
    ANY,
    PLAIN_ABSENT,
    STRICT,
    CheckedTable,
    Setting,
    grouped,
    setting,
    settings_class,
    unknown,
)

if TYPE_CHECKING:
    from typing_extensions import Self


@settings_class
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Settings(CheckedTable):
    """Base of the classes of settings of a run."""

    @field_validator("*", mode="before")
    @classmethod
    def _read(cls, value: Any, info: ValidationInfo) -> Any:
        of_field = cls.SETTINGS[str(info.field_name)]
        if of_field.kind is dict and isinstance(value, str):  # as a ROS parameter
            value = load_json(value, of_field.name)
        value = of_field.read(value)
        absent = of_field.optional and not isinstance(value, bool) and value == PLAIN_ABSENT[of_field.kind]
        return None if absent else value

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Self:
        """Make settings from names and values.

        Raises
        ------
        ValueError
            No mapping, an unknown name (the nearest known one is proposed) or a value that does not fit.
        """
        if not isinstance(values, Mapping):
            raise InputError(f"settings must be names with values, got {type(values).__name__}")
        return cls(**{str(name): value for name, value in values.items()})

    def to_plain(self) -> dict[str, Any]:
        """Names and values as files, ROS parameters and bags hold them, without ``None``."""
        return {name: one.plain(getattr(self, name)) for name, one in self.SETTINGS.items()}

    def to_strings(self) -> dict[str, str]:
        """The same as text, for the metadata of a bag."""
        return {name: v if isinstance(v, str) else json.dumps(v) for name, v in self.to_plain().items()}


__all__ = ["ANY", "STRICT", "Setting", "Settings", "grouped", "setting", "settings_class", "unknown"]
