"""Groups of commands whose commands are in several modules."""

from __future__ import annotations

from los_testbed.cli.bags.bag import bag_app
from los_testbed.cli.bags.bag_checks import INFO_EXAMPLES, SIGN_EXAMPLES, VERIFY_EXAMPLES, info, sign, verify
from los_testbed.cli.bags.bag_export import EXPORT_EXAMPLES, export
from los_testbed.cli.bags.bag_topics import TOPICS_EXAMPLES, topics
from los_testbed.cli.designs.check_proof import CHECK_PROOF_EXAMPLES, check_proof
from los_testbed.cli.designs.design import design_app
from los_testbed.cli.designs.proofs import CERTIFY_EXAMPLES, design_certify
from los_testbed.cli.designs.sensitivity import sensitivity

bag_app.command(name="topics", help=TOPICS_EXAMPLES)(topics)
bag_app.command(name="export", help=EXPORT_EXAMPLES)(export)
bag_app.command(name="info", help=INFO_EXAMPLES)(info)
bag_app.command(name="verify", help=VERIFY_EXAMPLES)(verify)
bag_app.command(name="sign", help=SIGN_EXAMPLES)(sign)
design_app.command("certify", help=CERTIFY_EXAMPLES)(design_certify)
design_app.command("check-proof", help=CHECK_PROOF_EXAMPLES)(check_proof)
design_app.command()(sensitivity)

__all__ = ["bag_app", "design_app"]
