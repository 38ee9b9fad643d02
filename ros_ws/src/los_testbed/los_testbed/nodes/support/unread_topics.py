"""Topics of a run without subscriber or without publisher, as after a missing remap."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.node import Node

from los_testbed.config.topics import BUNDLES, SENSORS, TopicDefinition
from pointing_analysis.read.messages.message_types import ACCEL, JOINT_STATE, VECTOR3

LISTENERS = ("recorder", "live")
"""Nodes that subscribe to everything."""

LAWS = ("estimator", "controller")


def unread_in_words(node: Node) -> str:
    """Topics of the nodes of a run without another subscriber, and without a publisher.

    Where the message with all samples of a tick is read, the topics of single sensors need no reader.

    Parameters
    ----------
    node : Node
        The plant's.
    """
    sensors = [node.resolve_topic_name(topic.name) for topic in SENSORS]
    bundles = {node.resolve_topic_name(name) for name in BUNDLES.values()}
    composed = bool(_readers(node, node.resolve_topic_name(BUNDLES["plant"])))
    laws = [name for name in LAWS if name in node.get_node_names()]
    sent = [] if composed or not laws else sensors
    heard: dict[str, str] = {}
    for name in laws:
        if not composed or name == "controller":
            sent += _topics(node.get_publisher_names_and_types_by_node(name, node.get_namespace()))
        heard |= dict.fromkeys(_topics(node.get_subscriber_names_and_types_by_node(name, node.get_namespace())), name)
    unread = [topic for topic in sent if topic not in bundles and not _readers(node, topic)]
    unsent = [f"{topic} (read by {name})" for topic, name in heard.items() if not node.count_publishers(topic)]
    words = [f"no subscriber for {', '.join(unread)}"] if unread else []
    words += [f"no publisher for {', '.join(unsent)}"] if unsent else []
    return "".join(f"; {text}" for text in words)


def bypassed_in_words(node: Node, topics: Iterable[TopicDefinition], bundle: str) -> str:
    """Warning if topics of single sensors or actuators are remapped and the message of all is used."""
    namespace = node.get_namespace().rstrip("/")
    names = [(f"{namespace}/{topic.name}", node.resolve_topic_name(topic.name)) for topic in topics]
    other = ", ".join(f"{usual} is {name}" for usual, name in names if usual != name)
    if not other:
        return ""
    return (
        f"{other}, but the loop uses {bundle}: a filter between the two names has no effect; start estimator and "
        "controller in processes of their own (--processes separate, composed:=false)"
    )


def _topics(names_and_types: Iterable[tuple[str, list[str]]]) -> list[str]:
    """Topics with the types of the loop."""
    return sorted(topic for topic, types in names_and_types if {ACCEL, JOINT_STATE, VECTOR3}.intersection(types))


def _readers(node: Node, topic: str) -> list[str]:
    """Nodes that read a topic."""
    names = [endpoint.node_name for endpoint in node.get_subscriptions_info_by_topic(topic)]
    return [name for name in names if name not in LISTENERS]
