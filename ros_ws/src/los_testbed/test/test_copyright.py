"""Licence: that of the repository, named in package.xml and setup.py."""

import re
from pathlib import Path
from xml.etree import ElementTree

PACKAGE = Path(__file__).parents[1]


def test_the_licence_is_named_and_is_that_of_the_repository():
    license_ = ElementTree.parse(PACKAGE / "package.xml").getroot().find("license")
    assert license_.text == "Apache-2.0"
    assert re.search(r'license="Apache-2.0"', (PACKAGE / "setup.py").read_text("utf-8"))
    text = (PACKAGE / license_.get("file")).resolve().read_text("utf-8")
    assert "Apache License" in text and "Version 2.0" in text
