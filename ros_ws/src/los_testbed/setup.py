"""ament_python package of the nodes.

The numeric packages (titop_plant, los_estimator, ...) come from the distribution ``los-testbed`` at the
root of the repository: ``pip install .`` there, in the environment that builds this workspace.
"""

from glob import glob

from setuptools import find_packages, setup

NAME = "los_testbed"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={NAME: ["profiles/*.xml", "*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*.yaml")),
        (f"share/{NAME}/layouts", glob("layouts/*")),
    ],
    install_requires=["setuptools"],
    tests_require=["pytest"],
    zip_safe=False,
    maintainer="The los-testbed developers",
    maintainer_email="los-testbed@example.org",
    description="Nodes of the line-of-sight testbed",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"{node} = {NAME}.nodes.{node}:main" for node in ("plant", "estimator", "controller", "recorder")
        ]
        + [f"los-testbed = {NAME}.cli.app:main"],
    },
)
