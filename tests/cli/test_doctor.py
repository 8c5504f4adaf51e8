"""What an installation has, told to people and programs; words completed in a shell."""

import json
import shutil
import subprocess
import sys
from importlib.metadata import version

import numpy as np
import pytest

from glissando.cli.completion import completion
from glissando.cli.doctor import advice
from glissando.cli.main import build_parser, main
from glissando.evaluation import environment

PORT = {
    "device": "/dev/ttyUSB0",
    "description": "USB serial",
    "group": "dialout",
    "may_open": True,
    "latency_ms": 1,
}


def found(**changes):
    return {
        "versions": {"python": "3.11"},
        "platform": "Linux",
        "cores": 2,
        "blas": [],
        "optional": [],
        "serial": [],
        **changes,
    }


def test_json_is_one_object_with_everything(capsys):
    assert main(["doctor", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed) == set(found())
    assert printed["versions"]["numpy"] == np.__version__
    assert all(pool["threads"] >= 1 for pool in printed["blas"])
    assert {"package", "version", "extra"} == set(printed["optional"][0])
    known = {entry["package"]: entry for entry in printed["optional"]}
    assert known["matplotlib"]["version"] == version("matplotlib")
    assert known["h5netcdf"]["extra"] == "netcdf"


def test_text_says_the_same_and_ends_with_0(capsys):
    assert main(["doctor"]) == 0
    printed = capsys.readouterr().out
    assert f"numpy {np.__version__}" in printed
    assert "serial devices" in printed or "/dev/" in printed


def test_a_missing_package_is_told_with_the_extra_that_brings_it(monkeypatch):
    stated = [
        "numpy>=2",
        'no-such-thing>=1; extra == "view"',
        "no-such-test; platform_system != 'Windows' and extra == 'test'",
        'glissando[view]; extra == "all"',
    ]
    monkeypatch.setattr(environment, "requires", lambda name: stated)
    assert environment.optional() == [
        {"package": "no-such-thing", "version": None, "extra": "view"}
    ]
    lines = advice(found(optional=environment.optional()))
    assert any("no-such-thing (view): missing: pip install 'glissando\\[view]'" in x for x in lines)


def test_the_latency_timer_is_read_where_linux_states_one(tmp_path):
    (tmp_path / "ttyUSB0").mkdir()
    (tmp_path / "ttyUSB0" / "latency_timer").write_text("16\n")
    assert environment.latency_ms("/dev/ttyUSB0", tmp_path) == 16
    assert environment.latency_ms("/dev/ttyS0", tmp_path) is None


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({}, ""),
        ({"latency_ms": None}, ""),
        ({"latency_ms": 16}, "latency timer 16 ms: echo 1 | sudo tee /sys/bus/usb-serial/"),
        ({"may_open": False}, "may not be opened: run sudo usermod -aG dialout $USER"),
        ({"may_open": False, "group": "uucp"}, "usermod -aG uucp"),
    ],
)
def test_a_port_that_would_not_do_is_told_with_what_to_do(changes, remedy):
    line = advice(found(serial=[{**PORT, **changes}]))[-1]
    assert line.startswith("/dev/ttyUSB0: USB serial")
    assert (remedy in line) if remedy else line == "/dev/ttyUSB0: USB serial"


def test_without_pyserial_devices_are_unknown_not_none(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial.tools.list_ports", None)
    assert environment.serial_devices() is None
    assert "unknown, pyserial is missing" in advice(found(serial=None))[-1]
    assert advice(found())[-1] == "serial devices: none"


def completed(script, *words):
    """What bash offers after the words of a line, the last of which is unfinished."""
    line = " ".join(f"'{word}'" for word in words)
    ask = f"COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _shtab_glissando"
    command = ["bash", "-c", f"{script}\n{ask}; echo ${{COMPREPLY[@]}}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


@pytest.fixture(scope="module")
def bash():
    return completion(build_parser(), "bash")


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["glissando", "est"], ["estimate"]),
        (["glissando", "--ver"], ["--version"]),
        (["glissando", "estimate", "--qu"], ["--query"]),
        (["glissando", "estimate", "folder", "--robot", "sli"], ["sliding700"]),
        (["glissando", "view", "--li"], ["--live"]),
        (["glissando", "view", "/et"], ["/etc"]),
    ],
)
def test_bash_completes_commands_options_robots_and_files(bash, words, offered):
    assert completed(bash, *words) == offered


def test_a_script_is_printed_for_shells_that_are_known(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--print-completion", "zsh"])
    assert ended.value.code == 0
    script = capsys.readouterr().out
    assert script.startswith("#compdef glissando")
    if shutil.which("zsh"):
        subprocess.run(["zsh", "-fc", f"autoload -U compinit; compinit; {script}"], check=True)
    with pytest.raises(SystemExit) as ended:
        main(["--print-completion", "fish"])
    assert ended.value.code == 2
