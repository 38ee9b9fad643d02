"""Configuration of a campaign and the content of its files as one text, from which a worker restores them."""

from __future__ import annotations

import atexit
import base64
import json
import shutil
import tempfile
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from lftkit.support.input_files import read_text
from los_design.copied_files import with_files_beside
from los_testbed.config.run_config import RunConfig

FILES = ("k_fsm", "k_pma")
"""Controllers of a campaign, which are files; beside them there is the parameter file with the files that it names."""


def portable(base: RunConfig, here: Mapping[str, str]) -> str:
    """Configuration, content of its files and identity of this process: workers need nothing but the package.

    Raises
    ------
    ValueError
        A file that cannot be read.
    """
    files = {name: read_text(path) for name in FILES if (path := getattr(base, name))}
    beside: dict[str, bytes] = {}
    if base.parameters:
        files["parameters"], beside = with_files_beside(Path(base.parameters))
    encoded = {name: base64.b64encode(content).decode() for name, content in beside.items()}
    content = {"run": base.to_mapping(), "files": files, "beside": encoded, "identity": dict(here)}
    return json.dumps(content, sort_keys=True)


@lru_cache(maxsize=2)
def base_of(content: str) -> RunConfig:
    """Configuration of a text of :func:`portable`, with its files on this machine."""
    packed = json.loads(content)
    if not packed["files"]:
        return RunConfig.from_mapping(packed["run"])
    folder = Path(tempfile.mkdtemp(prefix="los_testbed_files_", dir=_worker_folder()))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for name, text in packed["files"].items():
        path = folder / f"{name}{Path(packed['run'][name]).suffix}"
        path.write_text(text, "utf-8")
        packed["run"][name] = str(path)
    for name, encoded in packed["beside"].items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(base64.b64decode(encoded))
    return RunConfig.from_mapping(packed["run"])


def _worker_folder() -> str | None:
    """Folder of this Dask worker, which is removed when the worker ends; None outside of one."""
    from distributed import get_worker

    try:
        return str(get_worker().local_directory)
    except ValueError:
        return None
