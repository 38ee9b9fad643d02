"""Command ``los-testbed keys``: keys and permissions for a middleware with DDS security."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from lftkit.support.atomic_output import check_output
from los_testbed.cli.options.options import option
from los_testbed.config.run_config import NAMESPACE, RunConfig
from los_testbed.run.processes.keystore import write_keystore

KEYS_EXAMPLES = """Keys, certificates and signed permissions of the nodes, for a ROS 2 with DDS security (SROS 2).

**Examples**

    los-testbed keys keystore                          # valid for a year, on all domains

    los-testbed keys keystore --domain 7 --days 30     # on one domain, for a month
"""
MAX_DAYS = 3650


def keys(
    folder: Annotated[Path, typer.Argument(help="New folder for the keystore.")],
    namespace: Annotated[str, option("namespace")] = NAMESPACE,
    domain: Annotated[int | None, option("domain")] = None,
    days: Annotated[int, typer.Option(min=1, max=MAX_DAYS, help="Validity.")] = 365,
) -> None:
    """See KEYS_EXAMPLES."""
    config = RunConfig(namespace=namespace, domain=domain)
    check_output(folder, "FOLDER", new=True, folder=True)
    enclaves = write_keystore(folder, config.namespace, config.domain, days)
    sys.stdout.write("".join(f"{enclave}\n" for enclave in enclaves))
    sys.stderr.write(f"export ROS_SECURITY_KEYSTORE={folder.resolve()} ROS_SECURITY_ENABLE=true\n")
    sys.stderr.write("export ROS_SECURITY_STRATEGY=Enforce\n")
