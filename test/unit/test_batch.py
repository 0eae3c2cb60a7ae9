"""Batches: every run once, whatever happens to runs, processes, the journal's last line and the batch itself."""

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import batch_jobs
import pytest

from backlash_ros.simulation.batch import CannotRunError, Entry, Journal, run_batch

SUPPORT = Path(__file__).parents[1] / "support"


@pytest.mark.grid
def test_the_result_does_not_depend_on_the_number_of_cores(tmp_path: Path) -> None:
    results = []
    for cores in (1, 2):
        with Journal(tmp_path / f"{cores}") as journal:
            run_batch(batch_jobs.square, range(20), journal, cores=cores)
            results.append(list(journal.entries()))
    assert results[0] == results[1] == [Entry(number, number**2) for number in range(20)]


@pytest.mark.grid
def test_runs_that_fail_are_reported_and_the_rest_goes_on(tmp_path: Path) -> None:
    ended = []
    with Journal(tmp_path / "journal") as journal:
        run_batch(batch_jobs.troubled, range(9), journal, limit=1.0, cores=2, ended=ended.append)
        entries = list(journal.entries())
    assert sorted(ended) == entries
    assert [entry.number for entry in entries] == list(range(9))
    assert {entry.number: entry.failure for entry in entries if entry.failure} == {
        3: "ValueError: three is not liked",
        5: "it took longer than 1 s",
        7: "its process ended with exit code -9",
    }
    assert [entry.value for entry in entries if not entry.failure] == [0, 1, 2, 4, 6, 8]


def test_what_json_does_not_take_is_a_failure(tmp_path: Path) -> None:
    with Journal(tmp_path / "journal") as journal:
        run_batch(complex, range(1), journal, cores=1)
        assert "not JSON serializable" in next(journal.entries()).failure


def test_a_job_that_cannot_be_imported_stops_the_batch_and_is_not_written_down(tmp_path: Path) -> None:
    module = tmp_path / "gone_tomorrow.py"
    module.write_text("def job(number):\n    return number\n")
    sys.path.insert(0, str(tmp_path))
    try:
        import gone_tomorrow  # noqa: PLC0415
    finally:
        sys.path.remove(str(tmp_path))
    with Journal(tmp_path / "journal") as journal:
        with pytest.raises(CannotRunError, match="cannot import"):
            run_batch(gone_tomorrow.job, range(3), journal, cores=1)
        assert len(journal) == 0


@pytest.mark.parametrize("torn", ['{"number": 2, "value": 4, "fail', '{"number": 2}', "\0\0\0", "7\n", "{}\n"])
def test_a_last_line_that_was_cut_short_is_done_again(tmp_path: Path, torn: str) -> None:
    path = tmp_path / "journal"
    with Journal(path) as journal:
        journal.add(Entry(0, 0))
        journal.add(Entry(1, 1))
    whole = path.read_bytes()
    path.write_bytes(whole + torn.encode())
    with Journal(path) as journal:
        assert len(journal) == 2
        assert 2 not in journal
        assert path.read_bytes() == whole
        journal.add(Entry(2, 4))
        assert list(journal.entries()) == [Entry(0, 0), Entry(1, 1), Entry(2, 4)]


def test_a_number_is_counted_once(tmp_path: Path) -> None:
    with Journal(tmp_path / "journal") as journal:
        journal.add(Entry(4, "first"))
        journal.add(Entry(4, "second"))
        assert list(journal.entries()) == [Entry(4, "first")]


def test_two_processes_do_not_share_a_journal(tmp_path: Path) -> None:
    with Journal(tmp_path / "journal"), pytest.raises(OSError, match="another process runs this batch"):
        Journal(tmp_path / "journal")
    with Journal(tmp_path / "journal"):
        pass


BATCH = """
import sys
from functools import partial
from pathlib import Path
import batch_jobs
from backlash_ros.simulation.batch import Journal, run_batch

folder = Path(sys.argv[1])
with Journal(folder / "journal") as journal:
    run_batch(partial(batch_jobs.slow, folder, 0.05), range(40), journal, cores=2)
"""


def children_of(pid: int) -> set[int]:
    found = set()
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(status.read_text().rsplit(")", 1)[1].split()[1])
        except OSError:  # it has ended
            continue
        if parent == pid:
            found.add(int(status.parent.name))
    return found


@pytest.mark.grid
@pytest.mark.population
def test_a_kill_loses_the_runs_in_flight_alone(tmp_path: Path) -> None:
    """The second time only what is missing is done, and the workers of the first have ended by themselves."""
    path = tmp_path / "journal"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(SUPPORT), *sys.path])}
    command = [sys.executable, "-c", BATCH, str(tmp_path)]
    first = subprocess.Popen(command, env=environment)
    end = time.monotonic() + 60
    while not path.exists() or path.read_bytes().count(b"\n") < 10:
        assert time.monotonic() < end
        time.sleep(0.01)
    workers = children_of(first.pid)
    first.send_signal(signal.SIGKILL)
    first.wait()
    assert len(workers) == 2
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        assert time.monotonic() < end
        time.sleep(0.01)
    done = path.read_bytes().count(b"\n")
    assert done < 40
    subprocess.run(command, env=environment, check=True, timeout=60)
    assert len({json.loads(line)["number"] for line in path.read_text().splitlines()}) == 40
    with Journal(path) as journal:
        assert list(journal.entries()) == [Entry(number, number**2) for number in range(40)]
    times = [(tmp_path / f"{number}").read_text().count("done") for number in range(40)]
    assert sum(times) <= 40 + 2  # at most the two in flight were done again


@pytest.mark.grid
def test_a_cluster_that_loses_a_worker_loses_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A real scheduler and two workers as processes; one of them is killed in the middle."""
    distributed = pytest.importorskip("distributed")
    environment = {"PYTHONPATH": os.pathsep.join([str(SUPPORT), *sys.path])}
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, env=environment
    ) as cluster:
        victim = next(iter(cluster.workers.values())).pid
        count = 0

        def ended(_entry: Entry) -> None:
            nonlocal count
            count += 1
            if count == 5:
                os.kill(victim, signal.SIGKILL)

        with Journal(tmp_path / "journal") as journal:
            job = partial(batch_jobs.slow, tmp_path, 0.1)
            run_batch(job, range(40), journal, scheduler=cluster.scheduler_address, ended=ended)
            assert list(journal.entries()) == [Entry(number, number**2) for number in range(40)]
        assert count == 40
        with Journal(tmp_path / "troubled") as journal:
            run_batch(batch_jobs.troubled, range(9), journal, limit=1.0, scheduler=cluster.scheduler_address)
            failed = [entry.number for entry in journal.entries() if entry.failure]
        monkeypatch.setattr("backlash_ros.simulation.batch.cluster.code_digest", lambda: "of another version")
        with Journal(tmp_path / "other") as journal, pytest.raises(CannotRunError, match="another version"):
            run_batch(batch_jobs.square, range(9), journal, scheduler=cluster.scheduler_address)
    assert failed == [3, 5, 7]
    assert (tmp_path / "journal").read_text().count("\n") == 40
