"""What a skipped test lacks, and how to get it: one line per reason at the end of a test run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

REMEDIES = {
    "this processor has no extended precision": "run on x86-64, whose long double has 64 bits of mantissa",
    "no chromium": "install a browser: apt-get install chromium",
    "no node": "install Node.js: apt-get install nodejs",
    "could not import 'pandas": "install the extra: pip install 'los-testbed[dataframes]'",
    "could not import 'xarray": "install the extra: pip install 'los-testbed[dataframes]'",
    "could not import 'distributed": "install the extra: pip install 'los-testbed[campaign]'",
    "could not import 'cryptography": "install the extra: pip install 'los-testbed[campaign]'",
    "could not import 'numba": "install the extra: pip install 'los-testbed[fast]'",
    "could not import 'openpyxl": "install the extra: pip install 'los-testbed[xlsx]'",
    "could not import 'fmpy": "install the extra: pip install 'los-testbed[fmi]'",
    "could not import 'ziglang": "install the extra: pip install 'los-testbed[win64]'",
    "could not import 'h5py": "install the extra: pip install 'los-testbed[hdf5]'",
    "could not import 'pyarrow": "install the extra: pip install 'los-testbed[parquet]'",
    "could not import 'astropy": "install the extra: pip install 'los-testbed[image]'",
    "could not import 'typst": "install the extra: pip install 'los-testbed[pdf]'",
    "could not import 'pypdf": "install the extra: pip install 'los-testbed[dev]'",
    "could not import 'poppy": "install the extra: pip install 'los-testbed[dev]'",
    "could not import 'photutils": "install the extra: pip install 'los-testbed[dev]'",
    "could not import 'axe_core_python": "install the extra: pip install 'los-testbed[dev]'",
    "could not import 'mkdocs": "install the extra: pip install 'los-testbed[docs]'",
    "could not import 'nbclient": "install the extra: pip install 'los-testbed[notebooks]'",
    "could not import 'rclpy": "install the extra: pip install 'los-testbed[ros]'",
    "could not import 'std_srvs": "install the extra: pip install 'los-testbed[ros]'",
    "could not import 'tornado": "install the extra: pip install 'los-testbed[live]'",
    "could not import 'foxglove": "install the extra: pip install 'los-testbed[live]'",
    "could not import 'rosbags": "install the extra: pip install 'los-testbed[dev]'",
    "could not import 'mcap_ros2": "install the extra: pip install 'los-testbed[dev]'",
    "extra nastran": "install the extra: pip install 'los-testbed[nastran]'",
    "network namespaces are not permitted": "run as root (CAP_SYS_ADMIN) with iproute2: apt-get install iproute2",
    "real time is not permitted": "run as root or allow SCHED_FIFO (CAP_SYS_NICE, or rtprio in limits.conf)",
    "real-time scheduling is not permitted": "run as root or allow SCHED_FIFO (CAP_SYS_NICE, or rtprio in limits.conf)",
    "this machine is too slow": "run the tests of the nodes alone: pytest -m 'ros and not slow' tests",
    "mounting a small file system is not permitted": "run as root (CAP_SYS_ADMIN)",
    "only root can start a process of another user": "run as root",
    "no package index": "run where pip reaches a package index that has colcon",
    "no openssl": "install the program: apt-get install openssl",
    "no cross compiler and emulator of AArch64": "install them: apt-get install gcc-aarch64-linux-gnu "
    "libc6-dev-arm64-cross qemu-user",
    "no clang-tidy": "install the program: apt-get install clang-tidy",
    "no cppcheck": "install the program: apt-get install cppcheck",
    "no valgrind or gcc": "install the programs: apt-get install valgrind gcc libc6-dev",
    "no clang": "install the compiler: apt-get install clang",
    "no C compiler": "install a compiler: apt-get install gcc libc6-dev",
    "no make or cmake": "install the programs: apt-get install make cmake",
    "no fused multiply-add": "nothing: the test is for x86 processors with FMA3, from 2013 on",
    "has no share folder": "run beside a full ROS 2 Jazzy, whose packages bring their message definitions",
}
"""Beginning or part of a reason, and what to do about it."""


def remedy(reason: str) -> str | None:
    """What to do about a skip reason; None if that is not known."""
    return next((advice for part, advice in REMEDIES.items() if part in reason), None)


def summary(reasons: Iterable[str]) -> list[str]:
    """One line per reason, most frequent first.

    Examples
    --------
    >>> summary(["no chromium on this machine", "no chromium on this machine"])
    ['2 x no chromium on this machine -> install a browser: apt-get install chromium']
    """
    return [
        f"{count} x {reason} -> {remedy(reason) or 'no remedy is known'}"
        for reason, count in Counter(reasons).most_common()
    ]
