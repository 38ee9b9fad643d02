"""Keys for DDS security: files of SROS 2, chain of certificates, signatures, who may send what."""

import datetime
import email
import shutil
import stat
import subprocess
from fnmatch import fnmatchcase
from xml.etree import ElementTree

import pytest

pytest.importorskip("cryptography")
from cryptography import x509
from los_testbed.cli import app
from los_testbed.config.topics import NODES, TOPICS
from los_testbed.run.processes.enclaves import ENCLAVES, enclave_path, heard_by, sent_by

SPACE = "/telescope"
GRANT = "subject_name validity allow_rule default"
"""Order of the schema omg_shared_ca_permissions.xsd of DDS security 1.1."""
DOMAIN_RULE = (
    "domains allow_unauthenticated_participants enable_join_access_control discovery_protection_kind "
    "liveliness_protection_kind rtps_protection_kind topic_access_rules"
)
TOPIC_RULE = (
    "topic_expression enable_discovery_protection enable_liveliness_protection enable_read_access_control "
    "enable_write_access_control metadata_protection_kind data_protection_kind"
)
"""Order of the schema omg_shared_ca_governance.xsd."""
FILES = "cert.pem key.pem governance.p7s identity_ca.cert.pem permissions_ca.cert.pem permissions.p7s permissions.xml"
"""What the security plugins of rmw look for in an enclave, and the unsigned document."""


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys") / "store"
    assert app.main(["keys", str(folder), "--domain=7", "--days=30"]) == 0
    return folder


def openssl(*arguments):
    if shutil.which("openssl") is None:
        pytest.skip("no openssl on this machine")
    return subprocess.run(["openssl", *map(str, arguments)], capture_output=True, text=True)


def enclaves(store):
    return [store / "enclaves" / enclave_path(name, SPACE).lstrip("/") for name in ENCLAVES]


def test_each_enclave_has_the_files_of_sros2_and_only_the_owner_can_read_keys(store):
    for place in enclaves(store):
        assert {file.name for file in place.iterdir()} == set(FILES.split())
        assert all(file.resolve(strict=True).is_file() for file in place.iterdir())
    assert stat.S_IMODE(store.stat().st_mode) == 0o700
    assert {stat.S_IMODE(file.stat().st_mode) for file in store.rglob("*key.pem")} == {0o600}
    assert len(list(store.rglob("key.pem"))) == len(ENCLAVES)


def test_certificates_are_of_the_authority_and_name_their_enclave(store):
    now = datetime.datetime.now(datetime.timezone.utc)
    for place, name in zip(enclaves(store), ENCLAVES):
        done = openssl("verify", "-CAfile", place / "identity_ca.cert.pem", place / "cert.pem")
        assert done.returncode == 0, done.stderr
        certificate = x509.load_pem_x509_certificate((place / "cert.pem").read_bytes())
        assert certificate.subject.rfc4514_string() == f"CN={SPACE}/{name}"
        assert certificate.public_key().curve.name == "secp256r1"
        assert not certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
        left = certificate.not_valid_after_utc - now
        assert datetime.timedelta(days=29) < left <= datetime.timedelta(days=30)
        assert certificate.not_valid_before_utc < now - datetime.timedelta(hours=23)


def test_documents_are_signed_and_a_changed_one_is_refused(store, tmp_path):
    plant = enclaves(store)[0]
    for name in ("permissions", "governance"):
        signed = plant / f"{name}.p7s"
        authority = plant / "permissions_ca.cert.pem"
        done = openssl("smime", "-verify", "-text", "-in", signed, "-CAfile", authority)
        assert done.returncode == 0, done.stderr
        original = store / "enclaves/governance.xml" if name == "governance" else plant / "permissions.xml"
        assert done.stdout.split() == original.read_text().split()
        changed = tmp_path / signed.name
        changed.write_bytes(signed.read_bytes().replace(b"<id>7</id>", b"<id>8</id>"))
        assert openssl("smime", "-verify", "-text", "-in", changed, "-CAfile", authority).returncode != 0
    parts = email.message_from_bytes((plant / "permissions.p7s").read_bytes())
    assert parts.get_content_type() == "multipart/signed"


def tags(element):
    return [child.tag for child in element]


def test_permissions_have_the_elements_of_the_standard_in_their_order(store):
    for place, name in zip(enclaves(store), ENCLAVES):
        root = ElementTree.parse(place / "permissions.xml").getroot()
        assert root.tag == "dds" and tags(root) == ["permissions"]
        (grant,) = root.find("permissions")
        assert grant.get("name") == grant.findtext("subject_name").removeprefix("CN=") == f"{SPACE}/{name}"
        assert tags(grant) == GRANT.split() and tags(grant.find("validity")) == ["not_before", "not_after"]
        for time in grant.find("validity"):
            datetime.datetime.strptime(time.text, "%Y-%m-%dT%H:%M:%S")
        rule = grant.find("allow_rule")
        assert tags(rule) == ["domains", "publish", "subscribe"]
        assert [one.text for one in rule.find("domains")] == ["7"]
        assert set(tags(rule.find("publish/topics"))) == set(tags(rule.find("subscribe/topics"))) == {"topic"}
        assert grant.findtext("default") == "DENY"


def test_governance_lets_nobody_in_without_a_certificate(store):
    root = ElementTree.parse(store / "enclaves/governance.xml").getroot()
    (rule,) = root.find("domain_access_rules")
    assert tags(rule) == DOMAIN_RULE.split()
    assert rule.findtext("allow_unauthenticated_participants") == "false"
    assert {rule.findtext(f"{kind}_protection_kind") for kind in ("discovery", "liveliness", "rtps")} == {"ENCRYPT"}
    (topic,) = rule.find("topic_access_rules")
    assert tags(topic) == TOPIC_RULE.split()
    assert topic.findtext("enable_write_access_control") == topic.findtext("enable_read_access_control") == "true"


def may(expressions, name):
    return any(fnmatchcase(name, expression) for expression in expressions)


@pytest.mark.parametrize("space", ["/telescope", "/", "/a/b"])
def test_only_its_publisher_may_send_a_topic_of_the_loop_and_every_node_may_hear_it(space):
    for topic in TOPICS:
        name = f"rt{topic.path_in(space)}"
        assert [node for node in ENCLAVES if may(sent_by(node, space), name)] == [topic.publisher]
        assert all(may(heard_by(node, space), name) for node in NODES)
    progress = f"rt{space.rstrip('/')}/recorder/progress"
    assert [node for node in ENCLAVES if may(sent_by(node, space), progress)] == ["recorder"]


def test_requests_come_from_the_page_and_control_only():
    asked = "rq/telescope/plant/stopRequest"
    assert [node for node in ENCLAVES if may(sent_by(node, SPACE), asked)] == ["live", "control"]
    assert [node for node in NODES if may(heard_by(node, SPACE), asked)] == ["plant"]
    assert [node for node in ENCLAVES if may(sent_by(node, SPACE), "rr/telescope/plant/stopReply")] == ["plant"]


@pytest.mark.parametrize("name", NODES)
def test_reports_and_replies_come_from_their_node_only(name):
    for sent in (f"rt/telescope/{name}/diagnostics", f"rr/telescope/{name}/set_parametersReply"):
        assert [node for node in ENCLAVES if may(sent_by(node, SPACE), sent)] == [name]
