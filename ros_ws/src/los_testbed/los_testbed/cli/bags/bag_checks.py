"""Commands ``los-testbed bag info``, ``verify`` and ``sign``: contents, integrity and signature of a bag."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from pointing_analysis.command.options import MAX_CHUNK_MB, Json, MaxChunk
from pointing_analysis.command.output import chunk_limit, leave_if_contradicted, print_json
from pointing_analysis.command.screen import Screen, on_screen, say
from pointing_analysis.formatting.number_text import ABSENT, digits
from pointing_analysis.formatting.tables import Marked, TextTable, numbers, texts

if TYPE_CHECKING:
    from pointing_analysis.read.arrivals import Arrivals

INFO_EXAMPLES = """Show the contents of a bag: times, topics with types and counts, the run with its seed, hashes.

**Example**

    los-testbed bag info bags/run-20260101-120000
"""

VERIFY_EXAMPLES = """Read a whole bag and check its digests, counts and signature.

Exit code 0: intact. 1: damaged or incomplete. 5: contradicts its own digests, counts, or the signature.

Of any bag, of other programs too, the times of each topic are listed: messages lost before the recorder, by their
stamps, gaps, stalls (recorded late, together) and clock steps (positive: the stamps fell behind). They do not change
the code.

**Examples**

    los-testbed bag verify bags/run-20260101-120000

    los-testbed bag verify bags/run-20260101-120000 --public-key public.pem
"""

SIGN_EXAMPLES = """Sign a whole bag with an Ed25519 key; the signature is written beside its file, as NAME.mcap.sig.

**Example**

    openssl genpkey -algorithm ed25519 -out key.pem; openssl pkey -in key.pem -pubout -out public.pem

    los-testbed bag sign bags/run-20260101-120000 --key key.pem
"""

Bag = Annotated[Path, typer.Argument(help="Bag: folder or .mcap file.")]
MARKS = {"damaged": "bad", "contradicts": "bad", "agrees": "ok"}


def info(bag: Bag, max_chunk: MaxChunk = MAX_CHUNK_MB, json_: Json = False) -> None:
    """See INFO_EXAMPLES."""
    from los_testbed.bags.describe import describe_bag

    described, console = describe_bag(bag, chunk_limit(max_chunk)), Screen(stderr=json_)
    _show(console, described)
    for problem in described["problems"]:
        say(console, problem, "note")
    if json_:
        print_json(described)
    leave_if_contradicted(described["contradictions"])


def _show(console: Console, described: Mapping[str, Any]) -> None:
    """Lines like those of ``ros2 bag info``, and what only bags of this testbed have."""
    lines = {
        "files": ", ".join(described["files"]),
        "size": f"{described['size_bytes'] / 1e6:.3f} MB",
        "storage": "mcap",
    }
    if described["start_ns"] is not None:
        start = datetime.fromtimestamp(described["start_ns"] * 1e-9, timezone.utc)
        lines["start"] = f"{start:%Y-%m-%d %H:%M:%S} UTC ({described['start_ns'] * 1e-9:.9f})"
        lines["duration"] = f"{described['duration_s']:.9g} s"
    lines["messages"] = str(described["messages"])
    lines |= {key: str(value) for key, value in (described["run"] | described["hashes"]).items()}
    lines |= {f"SHA-256 of {name}": value for name, value in described["sha256"].items()}
    lines |= {f"SHA-256 of {name}": about["sha256"] for name, about in described["attachments"].items()}
    if described["digest"]:
        lines["digest"] = ", ".join(described["digest"])
    lines["signature"] = "present, not checked: los-testbed bag verify" if described["signed"] else "none"
    width = max(map(len, lines))
    for name, value in lines.items():
        say(console, f"{name:<{width}}  {value}")
    rows = [(name, topic["type"], str(topic["messages"])) for name, topic in described["topics"].items()]
    table = TextTable.of((*texts("topic", "type"), *numbers("messages")), rows)
    console.print(on_screen(table, box=None, padding=(0, 1)))


def verify(
    bag: Bag,
    public_key: Annotated[Path | None, typer.Option(help="PEM file of the key that must have signed the bag.")] = None,
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    json_: Json = False,
) -> None:
    """See VERIFY_EXAMPLES."""
    from los_testbed.bags.check import check_bag
    from los_testbed.bags.signature import public_key as read_key

    key = None if public_key is None else read_key("--public-key", public_key)
    check, console = check_bag(bag, chunk_limit(max_chunk), key), Screen(stderr=json_)
    rows = [(row.name, Marked(row.state, MARKS.get(row.state, "open")), row.found) for row in check.rows]
    console.print(on_screen(TextTable.of(("check", "result", "found"), rows, f"{bag}: {check.title}")))
    console.print(on_screen(_times(check.arrivals), whole=("topic",), box=None, padding=(0, 1)))
    for problem in check.problems:
        say(console, problem, "note")
    if json_:
        print_json(check.as_dict())
    if check.code:
        raise typer.Exit(check.code)


def _times(arrived: Mapping[str, Arrivals]) -> TextTable:
    """Rates, lost messages, and number and largest of the events, by topic."""
    from pointing_analysis.read.arrivals import KINDS

    rows = []
    for topic, times in arrived.items():
        rate = digits(None if times.period is None else 1.0 / times.period, 6)
        lost = ABSENT if times.lost is None else str(times.lost)
        cells = []
        for kind in KINDS:
            sizes = [event.size for event in times.of(kind)]
            cells.append(f"{len(sizes)} ({max(sizes, key=abs):.3g} s)" if sizes else "0")
        rows.append((topic, str(times.messages), rate, lost, *cells))
    heads = (*texts("topic"), *numbers("count", "Hz", "lost", *(f"{kind}s" for kind in KINDS)))
    return TextTable.of(heads, rows, "times of the messages; of gaps, stalls and clock steps the largest")


def sign(
    bag: Bag,
    key: Annotated[Path, typer.Option(help="PEM file of an Ed25519 private key without password.")],
    max_chunk: MaxChunk = MAX_CHUNK_MB,
    json_: Json = False,
) -> None:
    """See SIGN_EXAMPLES."""
    from los_testbed.bags.check import sign_bag
    from los_testbed.bags.signature import private_key

    written = sign_bag(bag, private_key("--key", key), chunk_limit(max_chunk))
    say(Screen(stderr=json_), f"signature {written}")
    if json_:
        print_json({"bag": str(bag), "signature": str(written)})
