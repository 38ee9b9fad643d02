"""Types of the messages of a channel, by the language in which a bag has their definition."""

from __future__ import annotations

from pointing_analysis.read.mcap.records import BagError, Channel
from pointing_analysis.read.messages.idl_definitions import parse_idl
from pointing_analysis.read.messages.ros_definitions import Definitions, parse_definition


def channel_types(channel: Channel) -> Definitions:
    """Types of the messages of a channel.

    Raises
    ------
    BagError
        Messages that are not CDR, or without a definition in ``ros2msg`` or ``ros2idl``.
    """
    if channel.encoding != "cdr":
        raise BagError(f"messages must be encoded as cdr, got {channel.encoding!r}")
    if not channel.definition:
        raise BagError(f"the bag must hold the definition of {channel.schema or 'the message type'}, got none")
    text = channel.definition.decode("utf-8", "replace")
    if channel.definition_encoding == "ros2idl":
        return parse_idl(channel.schema, text)
    if channel.definition_encoding != "ros2msg":
        got = f"got {channel.definition_encoding!r}"
        raise BagError(f"the definition of {channel.schema} must be ros2msg or ros2idl, {got}")
    return parse_definition(channel.schema, text)
