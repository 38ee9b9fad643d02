"""Environment variables of ROS 2, checked before anything is started: rclpy ends with a traceback, or not at all."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

from lftkit.errors import InputError

DOMAIN_VARIABLE, LAYER_VARIABLE = "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION"
MAX_DOMAIN_ID = 232
"""Above it the ports of DDS have no numbers."""

SWITCHES = ("RCUTILS_COLORIZED_OUTPUT", "RCUTILS_LOGGING_USE_STDOUT", "RCUTILS_LOGGING_BUFFERED_STREAM")
"""Variables that are 0 or 1; logging does not start with another value."""

INDEX = ("share", "ament_index", "resource_index", "rmw_typesupport")
"""Folder with a file named after each installed middleware layer."""


def check_variables(environment: Mapping[str, str]) -> None:
    """Refuse values with which ROS 2 does not start.

    Raises
    ------
    ValueError
        A domain that is none, a middleware layer that is not installed, a switch that is neither 0 nor 1, DDS security.

    Examples
    --------
    >>> check_variables({"ROS_DOMAIN_ID": "300"})
    Traceback (most recent call last):
        ...
    lftkit.errors.InputError: ROS_DOMAIN_ID must be between 0 and 232, got 300
    """
    domain_of(environment)
    check_layer(environment)
    for name in SWITCHES:
        if (value := environment.get(name, "")) not in ("", "0", "1"):
            raise InputError(f"{name} must be 0 or 1, got {value}")
    if environment.get("ROS_SECURITY_ENABLE", "").lower() == "true":
        raise InputError("ROS_SECURITY_ENABLE must be unset, as DDS security is not supported, got true")


def check_layer(environment: Mapping[str, str]) -> None:
    """Refuse a middleware layer that is not installed, where it is known which are.

    Raises
    ------
    ValueError
        Another one.
    """
    # Middleware layers that are installed where this interpreter or the ROS environment has its index
    places = [sys.prefix, *environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
    folders = [Path(place, *INDEX) for place in places if place]
    present = {file.name for folder in folders if folder.is_dir() for file in folder.iterdir()}
    layer, installed = environment.get(LAYER_VARIABLE, ""), sorted(present - {"rmw_implementation"})
    if layer and installed and layer not in installed:
        raise InputError(f"{LAYER_VARIABLE} must be {' or '.join(installed)}, which is installed, got {layer}")


def domain_of(environment: Mapping[str, str]) -> int:
    """Domain by the environment; 0 without one.

    Raises
    ------
    ValueError
        No whole number between 0 and 232.

    Examples
    --------
    >>> domain_of({"ROS_DOMAIN_ID": "17"}), domain_of({})
    (17, 0)
    """
    text = environment.get(DOMAIN_VARIABLE, "").strip()
    if not text:
        return 0
    if not (text.isascii() and text.isdecimal() and int(text[:9]) <= MAX_DOMAIN_ID and len(text) < 9):
        raise InputError(f"{DOMAIN_VARIABLE} must be between 0 and {MAX_DOMAIN_ID}, got {text}")
    return int(text)
