"""Refit of a fleet: the same answer everywhere, one unit's failure is its own, moments are made once."""

import json
import os
import pickle
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from bench.analysis.effects import registry
from bench.analysis.effects.model import Model
from bench.analysis.effects.spline import Spline
from bench.analysis.fit.fitting import fit_model
from bench.analysis.fit.from_moments import solve_moments
from bench.analysis.fit.moments import Moments
from bench.archive.fleet import collect, engines, moments_file
from bench.archive.fleet.moments_file import Stored
from bench.archive.fleet.refit import _lost, refit_group, refit_unit, refits, write_records
from bench.archive.registry.ledger import archive
from bench.archive.registry.opening import open_registry
from bench.base.errors import InputError
from bench.cli import main
from bench.record.reading import load
from tests.support.fleet_runs import fleet
from tests.support.run_folders import keep, make_run, ramp_run

MODEL = Model("spline 12", (Spline(12),))
UNITS = 700
DAMAGED = 300


@pytest.fixture(scope="module")
def moments(tmp_path_factory):
    """Three groups of simulated units, one of them damaged."""
    path = tmp_path_factory.mktemp("fleet") / "moments.parquet"
    rows = list(fleet(UNITS))
    rows[DAMAGED].values[400] = np.nan
    assert moments_file.write(path, rows) == UNITS
    return path


@pytest.fixture(scope="module")
def here(moments):
    return [
        record
        for some in engines.local_engine(1)(refits(MODEL), moments_file.stored_groups(moments))
        for record in some
    ]


def test_a_unit_that_fails_does_not_stop_the_rest(here):
    failed = [number for number, record in enumerate(here) if record.error]
    assert failed == [DAMAGED]
    assert "moments are damaged" in here[DAMAGED].error
    assert [record.unit for record in here] == [f"U-{number:06d}" for number in range(UNITS)]


def test_a_unit_fitted_again_alone_has_the_same_numbers(here, moments):
    group = next(moments_file.stored_groups(moments))
    for number in (0, 17, 255):
        assert refit_unit(MODEL, group.units[number], group.runs[number], group.values[number]) == here[number]


@pytest.mark.parametrize("engine", ["pool", "dask"])
@pytest.mark.slow
def test_two_workers_find_the_numbers_of_the_serial_refit_bit_for_bit(here, moments, engine):
    if engine == "dask":
        pytest.importorskip("distributed")
    run = engines.local_engine(2) if engine == "pool" else engines.dask_engine(2, None)
    there = [record for some in run(refits(MODEL), moments_file.stored_groups(moments)) for record in some]
    assert there == here


@pytest.fixture(scope="module")
def cluster():
    """A Dask cluster of one process."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0", host="127.0.0.1"
    ) as cluster:
        yield cluster


def test_a_cluster_of_others_is_reached_by_its_address(here, moments, cluster, tmp_path):
    target = tmp_path / "records.parquet"
    said = CliRunner().invoke(main, [
        "fleet", "refit", "--model", str(_model_file(tmp_path)),
        "--moments", str(moments), "--records", str(target), "--scheduler", cluster.scheduler_address, "--json",
    ], catch_exceptions=False)  # fmt: skip
    assert said.exit_code == 1, said.output
    assert json.loads(said.stdout)["failed"] == 1
    betas = pq.read_table(target).column("beta").to_pylist()
    assert [tuple(beta or ()) for beta in betas] == [record.beta for record in here]


class UnreadableError(Exception):
    """Pickled, but not read again: that needs two arguments."""

    def __init__(self, unit, why):
        super().__init__(f"{unit}: {why}")


def _raising(model, group):
    if "U-000003" in group.units:
        raise UnreadableError("U-000003", "no good")
    return refit_group(model, group)


def test_a_unit_whose_error_cannot_be_read_again_is_named_with_its_words(moments, cluster):
    whole = next(moments_file.stored_groups(moments))
    group = moments_file.Group(whole.units[3:4], whole.runs[3:4], whole.values[3:4])
    run = engines.dask_engine(1, cluster.scheduler_address)
    ((failed,),) = run(engines.Work(partial(_raising, MODEL), _lost), [group])
    assert failed.error == "not refitted: tests.archive.test_refit.UnreadableError: U-000003: no good"


def _model_file(folder):
    path = folder / "spline12.yaml"
    path.write_text(MODEL.to_yaml())
    return path


class Deadly(Model):
    """A model whose fit kills the process that pickles it back."""

    def __setstate__(self, state):
        if os.environ.get("BENCH_TEST_PARENT") != str(os.getpid()):
            os._exit(9)
        self.__dict__.update(state)


def test_a_group_that_kills_its_process_is_recorded_as_failed(moments, monkeypatch):
    monkeypatch.setenv("BENCH_TEST_PARENT", str(os.getpid()))
    whole = next(moments_file.stored_groups(moments))
    group = moments_file.Group(whole.units[:2], whole.runs[:2], whole.values[:2])
    (some,) = engines.local_engine(2)(refits(Deadly("deadly", (Spline(12),))), [group])
    assert len(some) == len(group.units)
    assert {record.error for record in some} == {"not refitted: its worker process died"}


@pytest.mark.parametrize("deadly", [(0,), (17,), (40, 41), (3, 200)])
def test_a_unit_that_kills_its_process_costs_no_other_one(moments, deadly):
    group = next(moments_file.stored_groups(moments))
    names = {group.units[number] for number in deadly}
    found = engines._halved(group, lambda part: "died" if names & set(part.units) else refit_group(MODEL, part), _lost)
    assert [record.unit for record in found if record.error] == sorted(names)
    assert [record.unit for record in found] == list(group.units)


class Gone:
    """A cluster without workers, and a task of it."""

    def nthreads(self):
        return {}

    def exception(self, timeout):
        raise TimeoutError


def test_a_cluster_whose_workers_are_all_gone_ends_with_a_sentence():
    with pytest.raises(InputError, match="no Dask worker for 60 s; start some"):
        engines._result(Gone(), Gone())


def test_a_worker_with_other_code_of_the_same_version_is_refused(monkeypatch):
    theirs = {**engines.fingerprint(), "code": "000000000000"}
    workers = SimpleNamespace(run=lambda function, _: {"tcp://a": function(), "tcp://b": theirs})
    with pytest.raises(InputError, match=r"worker tcp://b has code 000000000000, this computer [0-9a-f]{12}"):
        engines._require_same_code(workers)


def test_a_scheduler_that_goes_away_ends_with_a_sentence(moments):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0", host="127.0.0.1"
    ) as cluster:
        answers = engines.dask_engine(1, cluster.scheduler_address)(refits(MODEL), moments_file.stored_groups(moments))
        next(answers)
        cluster.close()
        with pytest.raises(InputError, match="the Dask scheduler went away"):
            list(answers)


def test_a_scheduler_that_goes_away_while_workers_are_asked_is_named(tmp_path):
    closed = pytest.importorskip("distributed.comm.core").CommClosedError

    def run(*_):
        raise closed("Stream is closed")

    for require in (engines._require_same_code, lambda client: engines._require_folder(client, tmp_path)):
        with pytest.raises(InputError, match="the Dask scheduler went away"):
            require(SimpleNamespace(run=run))


def test_no_scheduler_there_is_bad_input(moments, tmp_path):
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match="no Dask scheduler"):
        next(engines.dask_engine(1, "nonsense")(refits(MODEL), moments_file.stored_groups(moments)))


def test_without_a_scheduler_this_computer_refits_and_a_missing_dask_says_how_to_install_it(moments, monkeypatch):
    from bench.commands import refitting

    assert refitting.engine_of(refitting.RefitOptions(workers=2), groups=100)[0] == "pool, 2 workers"
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"gyro-thermal-bench\[fleet\]"):
        next(engines.dask_engine(1, None)(refits(MODEL), moments_file.stored_groups(moments)))


def test_records_are_written_whole_or_not_at_all(moments, tmp_path):
    target = tmp_path / "records.parquet"

    def broken():
        yield refit_group(MODEL, next(moments_file.stored_groups(moments)))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_records(target, MODEL, broken())
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_no_moments_is_refused(tmp_path):
    for name, content in (("broken", b"nonsense"), ("missing", None)):
        path = tmp_path / name
        if content:
            path.write_bytes(content)
        with pytest.raises(InputError, match="moments cannot be read"):
            moments_file.stored_count(path)


def test_memory_is_bounded_by_groups(moments):
    assert [len(group.units) for group in moments_file.stored_groups(moments)] == [256, 256, 188]


@pytest.fixture
def reports(tmp_path):
    root = tmp_path / "reports"
    for unit in ("U-1", "U-2"):
        make_run(root / unit / "r1", **ramp_run(), unit=unit, run="r1", created="2026-11-01T00:00:00+00:00")
    return root


def refit(root, *more, code=0):
    model = _model_file(root.parent)
    said = CliRunner().invoke(main, ["fleet", "refit", "--model", str(model), "--out", str(root), "--json", *more])
    assert said.exit_code == code, said.output
    return json.loads(said.stdout)


def rebuild(root):
    assert CliRunner().invoke(main, ["registry", "rebuild", "--out", str(root)]).exit_code == 0


def test_registered_runs_are_refitted_to_what_a_fit_of_their_rows_finds(reports):
    rebuild(reports)
    done = refit(reports)
    assert (done["units"], done["failed"], done["engine"]) == (2, 0, "serial")
    (beta, _) = pq.read_table(done["records"]).column("beta").to_pylist()
    direct = fit_model(MODEL, load(reports / "U-1" / "r1"), covariance="none", weights="count")
    np.testing.assert_allclose(beta, direct.beta, rtol=0, atol=1e-9 * np.max(np.abs(direct.beta)))


def test_moments_are_made_once_and_again_only_for_a_newer_run(reports, monkeypatch):
    rebuild(reports)
    refit(reports)
    made = []
    original = collect.Moments.of
    monkeypatch.setattr(collect.Moments, "of", lambda records: made.append(records[0].name) or original(records))
    refit(reports)
    assert made == []
    make_run(reports / "U-2" / "r2", **ramp_run(seed=5), unit="U-2", run="r2", created="2026-11-02T00:00:00+00:00")
    rebuild(reports)
    assert refit(reports)["units"] == 2
    assert made == ["r2"]


@pytest.fixture
def twenty(tmp_path):
    """A registered archive of twenty short runs."""
    root = tmp_path / "reports"
    for number in range(20):
        folder = root / f"U-{number:02d}" / "r1"
        make_run(folder, **ramp_run(seed=number), unit=folder.parent.name, run="r1")
    rebuild(root)
    return root


def gathered(root, target, engine):
    with open_registry(root / "registry.sqlite") as known:
        return collect.collect(known, archive(root), target, lambda groups: engine)


def test_what_other_processes_read_is_what_one_reads_bit_for_bit(twenty, tmp_path):
    def elsewhere(work, groups):
        for group in groups:
            do, some = pickle.loads(pickle.dumps((work.do, group)))
            yield pickle.loads(pickle.dumps(do(some)))

    files = [tmp_path / "one.parquet", tmp_path / "two.parquet"]
    for target, engine in zip(files, (engines.local_engine(1), elsewhere), strict=True):
        assert gathered(twenty, target, engine).fresh == 20
    assert files[0].read_bytes() == files[1].read_bytes()
    assert not list(tmp_path.glob("*.parts"))


def test_what_disturbed_a_run_is_in_no_moments(tmp_path):
    made = ramp_run()
    made["columns"]["rate"] += 20.0 * (np.abs(made["columns"]["time"] - 4650.0) < 150.0)
    run = make_run(tmp_path / "run", **made)
    (stored,) = collect._moments_of((collect.Due("U", "run", "", str(run)),))
    solved = solve_moments(MODEL, Moments.unpack(stored.values))
    assert solved.rms_dph == pytest.approx(fit_model(MODEL, load(run), weights="count").rms_dph, rel=1e-6)
    assert solved.rms_dph < 1.0


def test_a_collection_that_is_interrupted_goes_on_with_the_runs_that_were_in_work(twenty, tmp_path):
    whole, target = tmp_path / "whole.parquet", tmp_path / "moments.parquet"
    gathered(twenty, whole, engines.local_engine(1))

    def until_the_cluster_is_gone(work, groups):
        yield from (work.do(group) for group in groups[:2])
        raise InputError("the Dask scheduler went away")

    with pytest.raises(InputError, match="went away"):
        gathered(twenty, target, until_the_cluster_is_gone)
    (tmp_path / "moments.parts" / "000007.parquet").write_bytes(b"torn")
    assert gathered(twenty, target, engines.local_engine(1)).fresh == 12
    assert target.read_bytes() == whole.read_bytes()
    assert not (tmp_path / "moments.parts").exists()


def test_a_run_that_kills_its_process_is_named_and_costs_no_other_one(twenty, tmp_path):
    def deadly(work, groups):
        for group in groups:
            yield engines._halved(
                group,
                lambda part: engines._DIED if any(one.unit == "U-07" for one in part) else work.do(part),
                work.lost,
            )

    done = gathered(twenty, tmp_path / "moments.parquet", deadly)
    assert (done.rows, done.refused) == (19, [f"{twenty / 'U-07' / 'r1'}: not read: its worker process died"])


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ({"purpose": "verification"}, "1 of units that corrected themselves"),
        ({"state": "aborted"}, "1 that did not end as planned"),
        ({"profile": "one_rate"}, "1 of other profiles (one_rate; --profile)"),
    ],
)
def test_a_newer_run_of_another_kind_does_not_replace_the_calibration(reports, kind, words):
    later = {"run": "r2", "created": "2026-11-02T00:00:00+00:00", **kind}
    make_run(reports / "U-1" / "r2", **ramp_run(seed=5), unit="U-1", **later)
    rebuild(reports)
    done = refit(reports)
    assert done["left_out"] == [words]
    assert [run.endswith("U-1/r1") for run in pq.read_table(done["records"]).column("run").to_pylist()] == [True, False]


def test_a_newer_run_that_was_not_judged_does_not_replace_the_judged_one(reports):
    make_run(reports / "U-1" / "r2", **ramp_run(seed=5), unit="U-1", run="r2", created="2026-11-02T00:00:00+00:00")
    for run, verdict in (("r1", "PASS"), ("r2", "INVALID")):
        calibration = {
            "calibration": {"model": {"name": "spline"}, "coefficients": [], "parameters": [], "validity": {}}
        }
        keep(reports / "U-1" / run, "calibration.json", calibration)
        keep(reports / "U-1" / run, "limits.json", {"name": "line", "verdict": verdict, "results": []})
    rebuild(reports)
    done = refit(reports)
    (first, *_) = pq.read_table(done["records"]).column("run").to_pylist()
    assert first.endswith("U-1/r1")


def test_real_units_and_simulated_ones_do_not_stand_in_one_figure(reports):
    for simulated, unit in ((True, "U-1"), (False, "U-2")):
        make_run(reports / unit / "r3", **ramp_run(seed=5), unit=unit, run="r3", simulated=simulated)
    rebuild(reports)
    assert "simulated" in " ".join(refit(reports)["left_out"])


def test_a_run_without_moments_is_named_and_the_rest_refitted(reports):
    (reports / "U-2" / "r1" / "means.parquet").write_bytes(b"broken")
    rebuild(reports)
    done = refit(reports, code=1)
    assert done["units"] == 1
    assert "U-2/r1/means.parquet" in done["without_moments"][0]


def test_a_model_that_moments_cannot_say_is_refused_before_anything_is_read(tmp_path):
    said = CliRunner().invoke(main, ["fleet", "refit", "--model", "spline_lag_loop", "--out", str(tmp_path)])
    assert said.exit_code == 2
    assert "cannot be solved from moments" in said.stderr


def test_an_engine_that_cannot_use_a_scheduler_is_bad_input(reports):
    rebuild(reports)
    model = _model_file(reports.parent)
    given = ["--model", str(model), "--out", str(reports), "--engine", "pool", "--scheduler", "tcp://127.0.0.1:1"]
    said = CliRunner().invoke(main, ["fleet", "refit", *given])
    assert said.exit_code == 2
    assert "--scheduler is for --engine dask" in said.stderr


def test_a_stored_row_keeps_every_bit(tmp_path):
    row = next(iter(fleet(1)))
    moments_file.write(tmp_path / "m.parquet", [row])
    (back,) = moments_file.read(tmp_path / "m.parquet")
    assert isinstance(back, Stored)
    assert np.array_equal(back.values, row.values)


OWN = """
from dataclasses import dataclass
import numpy as np
from bench import Effect

@dataclass(frozen=True)
class Wave(Effect):
    \"""Equation: B = a sin(T / 3).\"""
    name = "wave"
    needs = ("temperature",)
    amplitudes = (("a", "deg/h"),)

    def columns(self, record, theta):
        return np.sin(record.channel("temperature") / 3.0)[:, None]
"""


@pytest.fixture
def wave(tmp_path, monkeypatch):
    """A model with an effect of the user's own file."""
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    registry.load_effect(f"{tmp_path / 'mine.py'}:Wave")
    return Model("waved", (registry.make("wave"), Spline(12)))


def offered(model, group):
    return [(model.effects[0] == registry.make("wave"), unit in registry.effect_names()) for unit in group]


@pytest.mark.slow
def test_other_processes_know_the_effects_of_the_user_too(wave):
    work = engines.Work(partial(offered, wave), _lost)
    (there,) = engines.local_engine(2)(work, [("wave", "another")])
    assert there == [(True, True), (True, False)]


def test_a_worker_with_another_version_of_an_effect_is_refused(wave, tmp_path):
    class Client:
        def run(self, function, effects):
            theirs = function(effects)
            (tmp_path / "mine.py").write_text(OWN.replace("3.0", "4.0"), encoding="utf-8")
            return {"tcp://there": theirs}

    with pytest.raises(InputError, match=r"worker tcp://there has effects .* install the same"):
        engines._require_same_code(Client(), registry.own_effects())
