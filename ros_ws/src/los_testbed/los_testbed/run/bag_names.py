"""Names of the bags of one run: NAME, and NAME-2, NAME-3 ... after restarts of the recorder."""

from __future__ import annotations

import glob
import itertools
from datetime import datetime
from pathlib import Path

from los_testbed.config.run_config import AUTO, RunConfig


def free_name(base: Path) -> Path:
    """Name of another bag beside `base`: the next number that is free."""
    return next(path for n in itertools.count(2) if not (path := base.with_name(f"{base.name}-{n}")).exists())


def recorded(base: Path) -> str:
    """Location of the record of a failed run, as the end of a message; empty without one."""
    bags = [path for path in sorted(base.parent.glob(f"{glob.escape(base.name)}*")) if _is_bag(path, base)]
    if not bags:
        return ""
    return f"; recorded until then: {', '.join(map(_with_repair, bags))}"


def _with_repair(bag: Path) -> str:
    """A bag, with the command that repairs it where its recorder has not closed it."""
    return f"{bag}" if (bag / "metadata.yaml").is_file() else f"{bag} (incomplete: los-testbed bag repair {bag})"


def _is_bag(path: Path, base: Path) -> bool:
    """Whether this is the requested folder, or one with a number appended."""
    rest = path.name[len(base.name) :]
    return path.is_dir() and (not rest or (rest[0] == "-" and rest[1:].isdigit()))


def new_bag(config: RunConfig) -> Path:
    """Unused name for a bag under bags/, with the requested mode."""
    mode = config.mode if config.mode_choice is None else AUTO
    stem = f"{datetime.now():%Y%m%d-%H%M%S}-{mode}-{config.loop}"
    folder = Path("bags")
    names = (folder / (stem if i == 0 else f"{stem}-{i}") for i in range(1000))
    return next(name for name in names if not name.exists())
