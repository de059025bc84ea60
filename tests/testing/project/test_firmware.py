import firmware
import pytest

CHAMBER = "chamber.yaml"


@pytest.fixture(scope="module")
def run(bench_station):
    return bench_station(chamber=CHAMBER, signals=firmware.SIGNALS, frames=firmware.Gyro().frames).run()


def test_the_bench_reads_it(run):
    assert run.done


def test_no_sample_is_lost(run):
    assert run.losses["received"] > 10_000
    assert run.losses["lost"] == 0


def test_its_bias_follows_its_thermometer(run):
    assert [suspect.effect for suspect in run.record().diagnose("polynomial").found] == []


def test_the_chamber_takes_the_set_point(bench_chamber):
    chamber = bench_chamber(chamber=CHAMBER)
    firmware.heat(chamber.port, 60.0)
    chamber.advance(600)
    assert chamber.air_degc == pytest.approx(60.0, abs=1.0)
