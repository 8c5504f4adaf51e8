"""The installation: versions, optional packages, BLAS threads, serial devices."""

from __future__ import annotations

import os
import platform
import re
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_info

from glissando.io.provenance import versions

_LATENCY = Path("/sys/bus/usb-serial/devices")
_EXTRA = re.compile(r"^([A-Za-z0-9_.-]+).*;.*extra == ['\"]([\w-]+)['\"]")


def system() -> dict[str, Any]:
    """The report of `glissando doctor` as a JSON object; no device is opened or changed."""
    blas = [
        {
            "library": pool["internal_api"],
            "version": pool["version"],
            "threads": pool["num_threads"],
        }
        for pool in threadpool_info()
        if pool["user_api"] == "blas"
    ]
    return {
        "versions": versions(),
        "platform": platform.platform(),
        "cores": os.cpu_count(),
        "blas": blas,
        "optional": optional(),
        "serial": serial_devices(),
    }


def optional() -> list[dict[str, str | None]]:
    """Optional packages: name, version (None if missing) and the extra that installs each."""
    try:
        requirements = requires("glissando") or []
    except PackageNotFoundError:  # run from a checkout that was never installed
        requirements = []
    pairs = dict.fromkeys(m.groups() for line in requirements if (m := _EXTRA.match(line)))
    return [
        {"package": name, "version": _version(name), "extra": extra}
        for name, extra in pairs
        if name != "glissando" and extra not in ("all", "test")
    ]


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def serial_devices() -> list[dict[str, Any]] | None:
    """Serial devices, their group, whether this user may open them, and latency timers.

    A USB serial adapter delays replies by its latency timer, 16 ms by default.

    Returns:
        A dictionary for each device; `latency_ms` is None for other devices and operating systems.
        None if pyserial is missing.
    """
    try:
        from serial.tools.list_ports import comports
    except ImportError:
        return None
    return [
        {
            "device": port.device,
            "description": port.description,
            "group": _group(port.device),
            "may_open": os.access(port.device, os.R_OK | os.W_OK),
            "latency_ms": latency_ms(port.device),
        }
        for port in sorted(comports(), key=lambda port: port.device)
    ]


def _group(device: str) -> str | None:
    try:
        return Path(device).group()
    except (OSError, KeyError, NotImplementedError):
        return None


def latency_ms(device: str, folder: Path = _LATENCY) -> int | None:
    """Latency timer of a USB serial device, ms; None if Linux reports none."""
    try:
        return int((folder / Path(device).name / "latency_timer").read_text())
    except (OSError, ValueError):
        return None
