"""Jobs and their processes: bounded, shared, kept, cancelled when no page waits, not affected by a dead worker."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest

from bench.web.jobs.lanes import CANCELLED, MOST_WAITING, PATIENCE_S, Full, Job, Jobs
from bench.web.jobs.workers import KILLED, GivenUp, Refused, Worker


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


class Slow(Worker):
    """Answers when it is released, or gives up when no page waits for it."""

    def __init__(self) -> None:
        super().__init__()
        self.go, self.begun, self.look = threading.Event(), threading.Event(), threading.Event()
        self.count = 0

    def compute(self, target: str, wanted: Mapping[str, Any], wanted_still: Callable[[], bool]) -> bytes:
        self.count += 1
        self.begun.set()
        while not self.go.wait(0.01):
            if not wanted_still():
                raise GivenUp
        if target == "refuse":
            raise Refused("too short")
        return b'{"answer": 42}'


@pytest.fixture
def slow() -> Slow:
    return Slow()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def jobs(slow: Slow, clock: Clock) -> Iterator[Jobs]:
    made = Jobs(clock, lambda: slow)
    yield made
    made.close()


def wait(jobs: Jobs, job: Job) -> None:
    ended = threading.Event()
    jobs.listen(job, ended.set)
    assert ended.wait(30)


def test_the_same_question_is_computed_once_and_its_answer_kept(jobs: Jobs, slow: Slow) -> None:
    first, second = (jobs.submit("analysis", "t", {}, key="k") for _ in range(2))
    assert first is second
    slow.go.set()
    wait(jobs, first)
    assert jobs.submit("analysis", "t", {}, key="k").result == b'{"answer": 42}'
    assert slow.count == 1


def test_a_failure_is_told_in_one_line_and_not_kept(jobs: Jobs, slow: Slow) -> None:
    slow.go.set()
    job = jobs.submit("analysis", "refuse", {}, key="k")
    wait(jobs, job)
    assert (job.state, job.detail) == ("failed", "too short")
    assert jobs.submit("analysis", "refuse", {}, key="k") is not job


def test_a_lane_goes_on_when_no_process_can_be_started(slow: Slow, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_memory() -> None:
        raise OSError(12, "Cannot allocate memory")

    monkeypatch.setattr(slow, "warm", no_memory)
    slow.go.set()
    jobs = Jobs(workers=lambda: slow)
    try:
        jobs.warm()
        wait(jobs, first := jobs.submit("fit", "target", {}))
        monkeypatch.setattr(slow, "compute", lambda *_: no_memory())
        wait(jobs, second := jobs.submit("fit", "target", {}))
        monkeypatch.undo()
        wait(jobs, third := jobs.submit("fit", "target", {}))
    finally:
        jobs.close()
    assert [job.state for job in (first, second, third)] == ["done", "failed", "done"]
    assert "Cannot allocate memory" in second.detail


def test_a_job_ends_when_its_page_is_gone(jobs: Jobs, slow: Slow) -> None:
    running, waiting = (jobs.submit("diagnosis", "t", {"n": n}) for n in range(2))
    assert slow.begun.wait(30)
    jobs.release(waiting)
    jobs.release(running)
    wait(jobs, running)
    assert (waiting.detail, running.detail) == (CANCELLED, CANCELLED)


def test_who_asks_for_what_was_given_up_gets_a_job_of_their_own(jobs: Jobs, slow: Slow) -> None:
    given_up = jobs.submit("diagnosis", "t", {}, key="k")
    assert slow.begun.wait(30)
    jobs.release(given_up)
    again = jobs.submit("diagnosis", "t", {}, key="k")
    assert again is not given_up
    slow.go.set()
    wait(jobs, again)
    assert again.state == "done"


def test_one_of_two_pages_does_not_take_the_answer_from_the_other(jobs: Jobs, slow: Slow) -> None:
    job = jobs.submit("diagnosis", "t", {}, key="k")
    jobs.submit("diagnosis", "t", {}, key="k")
    assert slow.begun.wait(30)
    jobs.release(job)
    slow.go.set()
    wait(jobs, job)
    assert job.state == "done"


def test_a_page_that_went_without_a_word_is_noticed(jobs: Jobs, slow: Slow, clock: Clock) -> None:
    job = jobs.submit("diagnosis", "t", {})
    assert slow.begun.wait(30)
    clock.now += PATIENCE_S
    wait(jobs, job)
    assert job.detail == CANCELLED


def test_asking_keeps_a_job_alive(jobs: Jobs, slow: Slow, clock: Clock) -> None:
    job = jobs.submit("diagnosis", "t", {})
    assert slow.begun.wait(30)
    for _ in range(3):
        clock.now += 0.9 * PATIENCE_S
        assert jobs.find(job.id) is job
    slow.go.set()
    wait(jobs, job)
    assert job.state == "done"


def test_the_queue_is_bounded(jobs: Jobs, slow: Slow) -> None:
    jobs.submit("analysis", "t", {})
    assert slow.begun.wait(30)
    for n in range(MOST_WAITING):
        jobs.submit("analysis", "t", {"n": n})
    with pytest.raises(Full, match="16 jobs wait already"):
        jobs.submit("analysis", "t", {})


def test_old_answers_are_forgotten_before_memory_is_short(
    jobs: Jobs, slow: Slow, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.web.jobs.lanes.KEPT_JOBS", 2)
    slow.go.set()
    made = [jobs.submit("analysis", "t", {}, key=str(n)) for n in range(3)]
    for job in made:
        wait(jobs, job)
    assert [jobs.find(job.id) is None for job in made] == [True, False, False]


@pytest.fixture
def worker() -> Iterator[Worker]:
    made = Worker()
    yield made
    made.close()


def run(worker: Worker, code: str, wanted_still: Callable[[], bool] = lambda: True) -> bytes:
    return worker.compute("builtins:eval", code, wanted_still)  # type: ignore[arg-type]


def test_a_worker_that_is_killed_is_replaced(worker: Worker) -> None:
    assert run(worker, "6 * 7") == b"42"
    before = worker.pid
    with pytest.raises(Refused) as caught:
        run(worker, "__import__('os').kill(__import__('os').getpid(), 9)")
    assert str(caught.value) == KILLED
    assert run(worker, "6 * 7") == b"42"
    assert worker.pid != before


def test_a_worker_says_in_one_line_why_not_and_goes_on(worker: Worker, capfd: pytest.CaptureFixture[str]) -> None:
    for code, said in (
        ("bytearray(1 << 60)", "needs more memory"),
        ("1 / 0", r"the computation failed \(ZeroDivisionError: division by zero\)"),
        ("float('nan')", r"the computation failed \(ValueError"),
        ("print('a library that talks') or 1 / 0", "failed"),
    ):
        with pytest.raises(Refused, match=said):
            run(worker, code)
    assert run(worker, "1") == b"1"
    assert "a library that talks" in capfd.readouterr().err


def test_a_computation_that_nobody_wants_is_ended(worker: Worker) -> None:
    with pytest.raises(GivenUp):
        run(worker, "__import__('threading').Event().wait()", lambda: False)
    assert worker.pid is None


def test_a_worker_gives_way_to_runs(worker: Worker) -> None:
    assert int(run(worker, "__import__('os').nice(0)")) >= 10
    assert run(worker, "open('/proc/self/oom_score_adj').read().strip()") == b'"1000"'
    assert run(worker, "__import__('os').environ['OPENBLAS_NUM_THREADS']") == b'"1"'
