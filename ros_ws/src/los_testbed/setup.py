"""ament_python package of the nodes.

The numeric packages come from the distributions ``lftkit``, ``pointing-analysis`` and ``los-testbed`` (titop_plant,
los_estimator, ...): ``pip install ./lftkit ./pointing_analysis .`` at the root of the repository, in the environment
that builds this workspace.
"""

import ast
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = "los_testbed"
TREE = ast.parse(Path(__file__).with_name(NAME).joinpath("__init__.py").read_text("utf-8"))
VERSION = next(ast.literal_eval(node.value) for node in TREE.body if isinstance(node, ast.Assign))

setup(
    name=NAME,
    version=VERSION,
    packages=find_packages(exclude=["test"]),
    package_data={
        NAME: [
            "nodes/support/transport/profiles/*.xml",
            "campaign/*.html.j2",
            "flight/templates/*.j2",
            "py.typed",
            "live/static/*",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*.yaml")),
        (f"share/{NAME}/layouts", glob("layouts/*")),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},  # by which colcon test chooses pytest
    zip_safe=False,
    maintainer="The los-testbed developers",
    maintainer_email="los-testbed@example.org",
    description="Nodes of the line-of-sight testbed",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"{program} = {NAME}.nodes.{program}:main"
            for program in ("plant", "estimator", "controller", "estimator_controller", "recorder", "live")
        ]
        + [f"los-testbed = {NAME}.__main__:main"],
    },
)
