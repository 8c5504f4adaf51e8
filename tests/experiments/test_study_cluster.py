"""Studies on processes: killed and resumed, on a cluster by address, with workers that die."""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

pytest.importorskip("pyarrow", reason="studies need pyarrow")
pytest.importorskip("distributed", reason="studies need dask")
pytest.importorskip("cryptography", reason="local studies need keys")

import dask
from distributed import Client
from distributed.security import Security

from glissando import GlissandoError
from glissando.cli.main import main
from glissando.experiments import runner
from glissando.experiments.runner import cluster, failure, outcome
from glissando.experiments.study.plan import load_study
from glissando.experiments.study.store import TABLE, Store, parquet, run_cells
from studies import write_study

PATIENCE = 300.0  # s, for whatever should take a few


def eventually(happens):
    """Wait until something is so, of which no event tells."""
    end = time.monotonic() + PATIENCE
    while not happens():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def study_command(file, out, *more):
    return [sys.executable, "-m", "glissando", "study", file, "--out", out, *map(str, more)]


def group_is_gone(leader):
    try:
        os.killpg(leader, 0)
    except ProcessLookupError:
        return True
    return False


def kept_cells(folder):
    parts = sorted((folder / "parts").glob("*.parquet"))
    return [cell for part in parts for cell in parquet().read_table(part)["id"].to_pylist()]


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="there is no kill -9")
def test_a_study_killed_half_way_and_resumed_gives_the_same_table(tmp_path):
    """The same, byte by byte, as that of a plain loop over the cells."""
    file = write_study(tmp_path, "noise = [0.5, 1, 2, 4, 8]", seeds=36)
    broken, whole = tmp_path / "broken", tmp_path / "whole"
    command = study_command(file, broken, "--workers", 2)
    with subprocess.Popen(command, start_new_session=True) as killed:
        eventually(lambda: kept_cells(broken))  # the first part
        killed.send_signal(signal.SIGKILL)
    eventually(lambda: group_is_gone(killed.pid))  # its workers end with it
    before = kept_cells(broken)
    assert 0 < len(before) < 180
    assert not (broken / TABLE).exists()

    again = study_command(file, broken, "--workers", 1, "--resume", "--json")
    with subprocess.Popen(again, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as resumed:
        study = load_study(file)
        plan, store = study.cells(), Store(study, whole, resume=False)
        store.add({cell.id: outcome(cell.scene, cell.seed) for cell in plan})
        store.join(plan)
        printed, complaints = resumed.communicate(timeout=PATIENCE)
    assert resumed.returncode == 0
    assert all(line.startswith(b"glissando: ") for line in complaints.splitlines())  # progress
    told = json.loads(printed)
    assert (told["cells"], told["failed"]) == (len(plan), 0) == (180, 0)
    assert (broken / TABLE).read_bytes() == (whole / TABLE).read_bytes()
    assert kept_cells(broken)[: len(before)] == before
    assert set(Counter(kept_cells(broken)).values()) == {1}  # none was run twice


@pytest.fixture
def loopback(tmp_path):
    """The address of a scheduler on loopback with two workers, each a process of its own."""
    where = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    python = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard"]
    started = [
        subprocess.Popen(
            [*python, "--host", "127.0.0.1", "--port", "0", "--scheduler-file", where], **quiet
        )
    ]
    try:
        eventually(lambda: where.exists() and where.read_text().endswith("}"))
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", where]
        worker += ["--nthreads", "1", "--no-nanny", "--no-dashboard"]
        worker += ["--local-directory", tmp_path / "scratch"]
        started += [subprocess.Popen(worker, **quiet) for _ in range(2)]
        yield json.loads(where.read_text())["address"]
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_cluster_by_address_does_the_cells_and_keeps_what_failed(loopback, tmp_path, capsys):
    file = write_study(tmp_path, 'shape = ["straight", "buckled.toml"]', seeds=6)
    with cluster(loopback, None) as client:
        client.wait_for_workers(2, timeout=PATIENCE)
        pids = {
            client.submit(os.getpid, pure=False, workers=[w]).result() for w in client.nthreads()
        }
    assert len(pids) == 2
    assert os.getpid() not in pids
    out = tmp_path / "out"
    arguments = ["study", str(file), "--out", str(out), "--scheduler", loopback]
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert "12 cells, 6 failed" in printed.out
    assert all(line.startswith("glissando: ") for line in printed.err.splitlines())  # progress
    rows = parquet().read_table(out / TABLE).to_pylist()
    for cell, row in zip(load_study(file).cells(), rows, strict=True):
        alone = outcome(cell.scene, cell.seed)
        assert {name: row[name] for name in alone} == alone
        assert (row["error"] is not None) == (row["shape"] == "buckled.toml")
    assert main([*arguments, "--resume"]) == 1  # nothing to do: failed cells stay as they are
    assert len(kept_cells(out)) == 12
    assert main([*arguments, "--retry"]) == 1
    assert len(kept_cells(out)) == 12 + 6


def die(scene, seed):
    """A cell that takes its worker with it, if its seed is 1."""
    if seed == 1:
        os._exit(1)
    return failure("lived")


@pytest.mark.slow
def test_a_worker_that_dies_costs_its_cell_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "outcome", die)
    study = load_study(write_study(tmp_path, "", seeds=3))
    store = Store(study, tmp_path / "out", resume=False)
    seen = []
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        cluster(None, 1) as client,
    ):
        run_cells(client, study.cells(), store, lambda done, failed: seen.append((done, failed)))
    errors = [store.rows[cell.id]["error"] for cell in study.cells()]
    assert errors == ["lived", "The cell kills its worker; is there too little memory?", "lived"]
    assert seen == [(1, 1), (2, 2), (3, 3)]


@pytest.mark.slow
def test_what_is_done_is_kept_when_interrupted(tmp_path):
    study = load_study(write_study(tmp_path, "", seeds=40))
    store = Store(study, tmp_path / "out", resume=False)

    def stop(done, failed):
        if done == 5:
            raise KeyboardInterrupt

    with cluster(None, 1) as client, pytest.raises(KeyboardInterrupt):
        run_cells(client, study.cells(), store, stop)
    assert len(kept_cells(tmp_path / "out")) == 5


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_one_sentence(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runner, "_PATIENCE", 0.5)
    file = write_study(tmp_path, "")
    address = "tcp://127.0.0.1:1"
    arguments = ["study", str(file), "--out", str(tmp_path / "out"), "--scheduler", address]
    assert main(arguments) == 2
    assert f"No scheduler answers at {address}" in capsys.readouterr().err


@pytest.mark.slow
def test_a_cluster_without_workers_and_one_of_another_version_are_refused(monkeypatch):
    monkeypatch.setattr(runner, "_PATIENCE", 0.5)
    with pytest.raises(GlissandoError, match="No worker has joined tls://"), cluster(None, 0):
        pass
    monkeypatch.setattr(runner, "_PATIENCE", PATIENCE)
    monkeypatch.setattr(runner, "__version__", "99")
    with pytest.raises(GlissandoError, match="and this is 99; install one"), cluster(None, 1):
        pass


@pytest.mark.slow
def test_no_process_is_left_behind(tmp_path):
    with cluster(None, 2) as client:
        pids = client.run(os.getpid).values()
    for pid in pids:
        eventually(lambda pid=pid: not Path(f"/proc/{pid}").exists())


@pytest.mark.slow
def test_nobody_else_has_a_local_cluster_run_anything():
    with cluster(None, 1) as client:
        (worker,) = client.nthreads()
        for address in (client.scheduler.address, worker):
            assert address.startswith("tls://127.0.0.1:")
        place = client.scheduler.address.removeprefix("tls://")
        for protocol, key in (("tcp", None), ("tls", Security.temporary())):
            with pytest.raises(OSError):  # noqa: PT011  (of whatever kind)
                Client(f"{protocol}://{place}", security=key, timeout=3.0)
        assert client.submit(abs, -1).result() == 1


def test_workers_and_a_scheduler_at_once_are_refused(tmp_path, capsys):
    file = write_study(tmp_path, "")
    for more in (["--workers", "0"], ["--workers", "2", "--scheduler", "tcp://127.0.0.1:1"]):
        assert main(["study", str(file), *more]) == 2
        assert "give one or more, and no --scheduler" in capsys.readouterr().err
