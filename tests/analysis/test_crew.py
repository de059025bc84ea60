"""Work shared with copies of the process: same answers for any number of workers, and none lost with a copy."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections import Counter
from functools import partial

import numpy as np
import psutil
import pytest

from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.noise import likelihood
from bench.analysis.noise.whitening import Ratios, Recursion, Whitener
from bench.base.crew import VARIABLE, Aside, shared, usual_workers
from bench.base.errors import InputError
from tests.support.hidden_runs import HiddenUnit
from tests.support.work import costs

fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")


def alone() -> bool:
    return threading.active_count() == 1


def squared(number: int) -> tuple[int, int]:
    return number**2, os.getpid()


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_answers_come_in_the_order_of_the_tasks(workers):
    found = shared([partial(squared, n) for n in range(20)], workers)
    assert [square for square, _ in found] == [n**2 for n in range(20)]
    assert workers > 1 or {pid for _, pid in found} == {os.getpid()}


@fork
def test_a_copy_that_dies_costs_no_answer():
    parent = os.getpid()

    def dies_elsewhere(number: int) -> int:
        if os.getpid() != parent:
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    assert shared([partial(dies_elsewhere, n) for n in range(9)], 2) == list(range(9))


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_is_that_of_the_task(workers):
    def refuses() -> None:
        raise InputError("too short")

    with pytest.raises(InputError, match="too short"):
        shared([refuses] * 4, workers)


@fork
def test_what_is_begun_aside_is_done_elsewhere_and_only_its_answer_comes_back():
    aside = Aside(os.getpid, workers=2)
    assert (aside.answer() != os.getpid()) == alone()
    assert Aside(os.getpid, workers=1).answer() == os.getpid()


@fork
def test_no_copy_is_left_behind():
    before = set(psutil.Process().children())
    aside = Aside(signal.pause, workers=2)
    aside.close()
    aside.close()
    assert set(psutil.Process().children()) <= before


def test_no_copy_is_made_beside_other_threads():
    """It would inherit locks that nobody opens any more."""
    going = threading.Event()
    other = threading.Thread(target=going.wait)
    other.start()
    try:
        assert {pid for _, pid in shared([partial(squared, n) for n in range(9)], 2)} == {os.getpid()}
    finally:
        going.set()
        other.join()


def test_the_number_of_workers_can_be_said(monkeypatch):
    monkeypatch.setenv(VARIABLE, "3")
    assert usual_workers() == 3
    monkeypatch.setenv(VARIABLE, "")
    assert usual_workers() in {1, 2}


SPLINE = Model("spline", (effects.make("spline", {"intervals": 12}),))
RECURSIONS, WHITENERS, WHITENINGS = 70, 290, 750_000  # the search for formulas included
FEW = [effects.make(name) for name in ("thermal_lag", "temperature_rate", "hysteresis", "supply_voltage", "aging")]


@pytest.fixture(scope="module")
def run():
    return HiddenUnit(({"mechanism": "thermal_lag", "tau_s": 200.0},)).at_strength(1.0, "short").run("short", seed=1)


def answer(run, workers):
    """As text, so that every digit counts; no whitener is left from before."""
    likelihood._axis.cache_clear()
    return json.dumps(diagnose([run], SPLINE, candidates=FEW, floor_dph=0.1, workers=workers).to_json())


def test_two_workers_say_what_one_says_digit_for_digit(run):
    assert answer(run, 1) == answer(run, 2)


def test_a_whitener_has_the_same_digits_alone_and_in_company():
    time_s = 30.0 * np.arange(100)
    ratios = [Ratios(0.1 * n, 0.2) for n in range(1, 6)]
    together = Recursion(time_s, 30.0).whiteners(ratios)
    for ratio, other in zip(ratios, together, strict=True):
        one = Whitener.of(ratio, time_s, 30.0)
        assert one.log_det == other.log_det
        assert np.array_equal(one.transfer, other.transfer)


def test_a_diagnosis_makes_each_whitener_once_and_whitens_so_much(run, monkeypatch):
    """Work of one worker: passes over the rows that make whiteners, and columns that are whitened."""
    counts: Counter[str] = Counter()
    made, apply = Recursion.whiteners, Whitener.apply

    def counted(self, ratios):
        counts["recursions"] += 1
        counts["whiteners"] += len(ratios)
        return made(self, ratios)

    def applied(self, matrix):
        counts["whitenings"] += matrix.size // len(matrix)
        return apply(self, matrix)

    monkeypatch.setattr(Recursion, "whiteners", counted)
    monkeypatch.setattr(Whitener, "apply", applied)
    answer(run, 1)
    costs(counts["recursions"], RECURSIONS)
    costs(counts["whiteners"], WHITENERS)
    costs(counts["whitenings"], WHITENINGS)
