"""Other people's readers understand what is written here: the C++ library and pyigtl."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from glissando.hardware.openigtlink import Endpoint, Message, encode, stamp_of
from glissando.hardware.openigtlink import contents as c
from glissando.hardware.openigtlink.polydata import Attribute, PolyData
from igtl_messages import random_pose
from waiting import until

READER = Path(__file__).parents[2] / "support" / "igtl_reader.cxx"


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """A program that reads messages with the C++ library, compiled here."""
    root = Path(os.environ.get("OPENIGTLINK_ROOT", "/usr"))
    headers = root / "include" / "openigtlink"
    if not headers.is_dir() or not shutil.which("g++"):
        pytest.skip("no g++, or no C++ library of OpenIGTLink under OPENIGTLINK_ROOT or /usr")
    program = tmp_path_factory.mktemp("igtl") / "reader"
    lib = next(root.glob("lib/**/libOpenIGTLink.so")).parent
    found = [f"-I{headers}", str(READER), "-o", str(program), f"-L{lib}", "-lOpenIGTLink"]
    subprocess.run(["g++", *found, f"-Wl,-rpath,{lib}"], check=True)
    return program


def _read(program, *contents):
    wire = b"".join(encode(Message(each, "device", stamp_of(12.5))) for each in contents)
    done = subprocess.run([program], input=wire, capture_output=True, check=True)
    return done.stdout.decode().splitlines()


@pytest.mark.slow
def test_the_cpp_library_reads_every_type_that_is_sent(library):
    rng = np.random.default_rng(1)
    poses = [random_pose(rng) for _ in range(2)]
    points = rng.normal(size=(4, 3))
    mesh = PolyData(
        points,
        lines=(np.array([0, 1, 2, 3]),),
        polygons=np.array([[0, 1, 2], [1, 2, 3]]),
        attributes=(Attribute("sigma", np.arange(4.0)[:, None]), Attribute("odd", points[:, :1])),
    )
    tools = (c.Tool("one", c.TOOL_6D, poses[0]), c.Tool("two", c.TOOL_5D, poses[1]))
    contents = (
        c.Transform(poses[0]), c.TrackingData(tools), mesh, c.Text("a text"), c.Status(1, "well"),
    )  # fmt: skip
    lines = _read(library, *contents)
    assert len(lines) == 5
    assert not any("REFUSED" in line for line in lines)
    half = " device 12 2147483648 "
    kind, rest = lines[0].split(half)
    assert kind == "TRANSFORM"
    np.testing.assert_allclose(np.fromstring(rest, sep=" "), poses[0][:3].ravel(), rtol=1e-7)
    places = [f"{x:.9g}" for pose in poses for x in pose[:3, 3].astype(np.float32)]
    named = ["one", "2", *places[:3], "two", "4", *places[3:]]
    assert lines[1].split(half)[1].split() == named
    last = f"{np.float32(points[-1, 0]):.9g}"
    assert lines[2].split(half)[1].split() == ["4", "1", "2", "sigma", "3", "odd", last]
    assert lines[3].split(half)[1] == "a text"
    assert lines[4].split(half)[1] == "1 well"


def test_pyigtl_reads_what_a_server_of_ours_sends():
    pyigtl = pytest.importorskip("pyigtl", reason="pyigtl, another reader, is not installed")
    pose = random_pose(np.random.default_rng(2))
    point = c.Point("tip", np.array([1.0, 2.0, 3.0]), 0.5)
    contents = {"pose": c.Transform(pose), "text": c.Text("a text"), "tips": c.Points((point,))}
    with Endpoint("igtl-server://:0") as server:
        client = pyigtl.OpenIGTLinkClient("127.0.0.1", server.address.port)
        try:
            until(lambda: server.receive() or server.peers)
            server.send([encode(Message(each, name)) for name, each in contents.items()])
            read = {name: client.wait_for_message(name, timeout=20) for name in contents}
        finally:
            client.stop()
    np.testing.assert_allclose(read["pose"].matrix, pose)
    assert read["text"].string == "a text"
    np.testing.assert_allclose(read["tips"].positions, [[1.0, 2.0, 3.0]])


def test_what_pyigtl_sends_is_read():
    pyigtl = pytest.importorskip("pyigtl", reason="pyigtl, another sender, is not installed")
    pose = random_pose(np.random.default_rng(3))
    server = pyigtl.OpenIGTLinkServer(port=0, local_server=True)
    try:
        port = server.server_address[1]
        with Endpoint(f"igtl://127.0.0.1:{port}") as client:
            until(server.is_connected)
            message = pyigtl.TransformMessage(pose, device_name="pose", timestamp=1.7e9 + 0.25)
            server.send_message(message, wait=True)
            ((_, read),) = until(client.receive)
    finally:
        server.stop()
    assert (read.device, read.content.type_id) == ("pose", "TRANSFORM")
    np.testing.assert_allclose(read.content.matrix, pose)
    assert abs(read.stamp - stamp_of(1.7e9 + 0.25)) <= 2
