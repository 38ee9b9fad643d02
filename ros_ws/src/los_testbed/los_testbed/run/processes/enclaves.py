"""Permissions of each node of a run, as the two XML documents of DDS security 1.1.

The names are those of ROS 2 in the middleware: ``rt`` before a topic, ``rq`` and ``rr`` before request and reply of a
service. Every node may hear all topics of the run; it may send its own only.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from xml.etree import ElementTree

from los_testbed.config.topics import BUNDLES, COMMANDED, DIAGNOSTICS_TOPIC, IMAGE_NAME, NODES, PLACED, TOPICS
from los_testbed.run.processes.viewers import LIVE

CONTROL = "control"
"""Enclave of ``los-testbed control``."""

ENCLAVES = (*NODES, LIVE, CONTROL)
MAX_DOMAIN = 232
SCHEMA = "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_{}.xsd"
XSI = "http://www.w3.org/2001/XMLSchema-instance"

EVERYBODY_SENDS = ("rt/rosout", "rt/parameter_events", "ros_discovery_info")
EVERYBODY_HEARS = ("rt/parameter_events", "rt/clock", "ros_discovery_info")
ENCRYPT = ("discovery_protection_kind", "liveliness_protection_kind", "rtps_protection_kind")
TOPIC_PROTECTION = {
    "enable_discovery_protection": "true",
    "enable_liveliness_protection": "true",
    "enable_read_access_control": "true",
    "enable_write_access_control": "true",
    "metadata_protection_kind": "ENCRYPT",
    "data_protection_kind": "ENCRYPT",
}


def sent_by(name: str, namespace: str) -> tuple[str, ...]:
    """Expressions of the names in the middleware to which a node may send.

    Examples
    --------
    >>> [name for name in sent_by("controller", "/telescope") if name.endswith("/command")]
    ['rt/telescope/fsm/command', 'rt/telescope/pma/command', 'rt/telescope/actuator/*/command']
    """
    space = namespace.rstrip("/")
    own = [f"rt{topic.path_in(namespace)}" for topic in TOPICS if topic.publisher == name]
    own += [f"rt{space}/{bundle}" for node, bundle in BUNDLES.items() if node == name]
    if name != CONTROL:
        own += [f"rt{space}/{name}/*", f"rr{space}/{name}/*", f"rt{DIAGNOSTICS_TOPIC}"]
    if name == "plant":
        own += ["rt/clock", f"rt{space}/{IMAGE_NAME}", f"rt{space}/{PLACED}/*"]
    if name == "controller":
        own.append(f"rt{space}/{COMMANDED}/*/command")
    if name in (LIVE, CONTROL):
        own += [f"rq{space}/*", *(f"{kind}{node}" for node in _askers(name, space) for kind in ("rt", "rr"))]
    return (*own, *EVERYBODY_SENDS)


def heard_by(name: str, namespace: str) -> tuple[str, ...]:
    """Expressions of the names in the middleware from which a node may receive."""
    space = namespace.rstrip("/")
    own = [f"rt{space}/*", f"rt{DIAGNOSTICS_TOPIC}"]
    if name in (LIVE, CONTROL):
        own += [f"rr{space}/*", *(f"rq{node}" for node in _askers(name, space))]
    else:
        own.append(f"rq{space}/{name}/*")
    return (*own, *EVERYBODY_HEARS)


def _askers(name: str, space: str) -> list[str]:
    """Nodes of clients, which have numbers in their names."""
    return [f"{space}/{LIVE}/*", f"{space}/{LIVE}_control_*"] if name == LIVE else [f"/{CONTROL}_*"]


def permissions(name: str, namespace: str, domain: int | None, begin: datetime, end: datetime) -> str:
    """Permissions document of a node.

    Parameters
    ----------
    name : one of ENCLAVES
    namespace : of the run
    domain : ROS domain; None for all
    begin, end : validity, UTC
    """
    enclave = enclave_path(name, namespace)
    root = _document("permissions")
    grant = _add(_add(root, "permissions"), "grant")
    grant.set("name", enclave)
    _add(grant, "subject_name", f"CN={enclave}")
    validity = _add(grant, "validity")
    for tag, time in (("not_before", begin), ("not_after", end)):
        _add(validity, tag, f"{time:%Y-%m-%dT%H:%M:%S}")
    rule = _add(grant, "allow_rule")
    _add_domains(rule, domain)
    for tag, names in (("publish", sent_by(name, namespace)), ("subscribe", heard_by(name, namespace))):
        _add_each(_add(_add(rule, tag), "topics"), "topic", names)
    _add(grant, "default", "DENY")
    return _text(root)


def governance(domain: int | None) -> str:
    """Governance document: certificate required, all traffic encrypted, access control on every topic."""
    root = _document("governance")
    rule = _add(_add(root, "domain_access_rules"), "domain_rule")
    _add_domains(rule, domain)
    _add(rule, "allow_unauthenticated_participants", "false")
    _add(rule, "enable_join_access_control", "true")
    for tag in ENCRYPT:
        _add(rule, tag, "ENCRYPT")
    topic = _add(_add(rule, "topic_access_rules"), "topic_rule")
    _add(topic, "topic_expression", "*")
    for tag, value in TOPIC_PROTECTION.items():
        _add(topic, tag, value)
    return _text(root)


def enclave_path(name: str, namespace: str) -> str:
    """Enclave of a node: the name of its certificate.

    Examples
    --------
    >>> enclave_path("plant", "/telescope"), enclave_path("plant", "/")
    ('/telescope/plant', '/plant')
    """
    return f"{namespace.rstrip('/')}/{name}"


def _document(kind: str) -> ElementTree.Element:
    return ElementTree.Element("dds", {"xmlns:xsi": XSI, "xsi:noNamespaceSchemaLocation": SCHEMA.format(kind)})


def _add(parent: ElementTree.Element, tag: str, text: str | None = None) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, tag)
    child.text = text
    return child


def _add_each(parent: ElementTree.Element, tag: str, texts: Sequence[str]) -> None:
    for text in texts:
        _add(parent, tag, text)


def _add_domains(rule: ElementTree.Element, domain: int | None) -> None:
    domains = _add(rule, "domains")
    if domain is not None:
        _add(domains, "id", str(domain))
        return
    everything = _add(domains, "id_range")
    _add(everything, "min", "0")
    _add(everything, "max", str(MAX_DOMAIN))


def _text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
