"""Guards that no station file can lack: what trips them, and what a sound run does that must not."""

import pytest

from bench.acquisition.profile.guards import Guards, GuardSettings, Signal, guards_of
from bench.acquisition.profile.preflight import Limits
from bench.acquisition.profile.standing import ProtectionSettings, guards_told, standing_guards
from bench.acquisition.run.plausible import Plausible, SetpointExcess, UnitExcess, reads_degf
from bench.acquisition.run.runner import run_job
from bench.base.errors import InputError
from drivers.chamber import ChamberReading
from drivers.sim.plant import Plant, PlantParameters
from tests.support import acquisition
from tests.support.acquisition import at

LIMITS = Limits(-42.0, 95.0, 5.0, ((-40.0, 0.5), (-30.0, 1.5), (0.0, 2.3), (23.0, 3.0), (85.0, 5.0)))
STANDING = standing_guards(LIMITS, ProtectionSettings())


def reading(t_s, air, setpoint, working=None, on=True):
    return ChamberReading(t_s, air, setpoint, working, None, on, (), None)


class World:
    """The plant model under the guards of every run, a reading a second; the unit is its case."""

    def __init__(self, setpoint=23.0, start_degc=None):
        self.plant = Plant(PlantParameters(), start_degc=start_degc)
        self.guards = Guards([one.guard for one in STANDING])
        self.plausible = Plausible(LIMITS, ProtectionSettings().unit_lag_min)
        self.t_s, self.setpoint, self.rate = 0.0, setpoint, None
        self.show = lambda air, unit: (air, unit)

    def live(self, seconds):
        """Names of the guards that tripped."""
        tripped = []
        for _ in range(round(seconds)):
            self.t_s += 1.0
            self.plant.step(1.0, self.setpoint, on=True, ramp_degc_per_min=self.rate)
            state = self.plant.state
            air, unit = self.show(state.process_value, state.case)
            seen = reading(self.t_s, air, state.setpoint, state.working_setpoint)
            self.plausible.take(seen, ours_on=True)
            now = Signal(unit, self.t_s)
            signals = {"chamber_temperature": Signal(air, self.t_s), "unit_temperature": now, "unit_coldest": now}
            signals |= self.plausible.signals(seen, [now]) | {"unit_doubted_s": Signal(0.0, self.t_s)}
            tripped += [trip.guard.name for trip in self.guards.evaluate(signals, self.t_s) if trip.tripped]
        return tripped


def test_steps_and_ramps_from_end_to_end_trip_nothing():
    world = World()
    for setpoint, rate, seconds in [
        (85.0, None, 3600),
        (-40.0, None, 7200),
        (85.0, 5.0, 3600),
        (-40.0, 5.0, 7200),
        (23.0, 1.0, 4000),
    ]:
        world.setpoint, world.rate = setpoint, rate
        assert world.live(seconds) == []


@pytest.mark.parametrize(
    ("show", "name", "within_s"),
    [
        (lambda air, unit: (250.0, unit), "air limits", 10),
        (lambda air, unit: (-60.0, unit), "air limits", 10),
        (lambda air, unit: (air, 160.0), "unit too hot", 10),
        (lambda air, unit: (air, -164.0), "unit too cold", 10),
        (lambda air, unit: (air + 25.0, unit), "air changes too fast", 10),
        (lambda air, unit: (air * 1.8 + 32.0, unit), "air changes too fast", 10),
        (lambda air, unit: (air + 15.0, unit), "air off its set point", 310),
        (lambda air, unit: (air, unit + 20.0), "unit off the air", 70),
    ],
    ids=["250", "-60", "unit 160", "unit -164", "jump", "degF in mid-run", "off by 15", "unit jumps by 20"],
)
def test_what_cannot_be_ends_the_run(show, name, within_s):
    world = World()
    assert world.live(900) == []
    world.show = show
    assert name in world.live(within_s)


def test_a_chamber_that_no_longer_cools_is_noticed():
    world = World(setpoint=-30.0)
    assert world.live(7200) == []
    frozen = world.plant.state.process_value
    world.show = lambda air, unit: (frozen + min((world.t_s - 7200) / 60.0, 50.0), unit)
    assert "air off its set point" in world.live(1200)


def test_a_chamber_that_is_off_or_not_ours_is_not_expected_anywhere():
    excess = SetpointExcess(LIMITS)
    assert [excess.take(reading(t_s, 23.0, 80.0, on=False), ours_on=True) for t_s in range(100)] == [0.0] * 100
    assert [excess.take(reading(t_s, 23.0, 80.0), ours_on=False) for t_s in range(100, 200)] == [0.0] * 100


def test_a_unit_that_starts_warm_may_cool_as_slowly_as_its_lag():
    excess = UnitExcess(lag_min=60.0)
    assert all(excess.take(60.0 * i, 23.0, [23.0 + 50.0 * 2.718 ** (-i / 50)]) < 1e-9 for i in range(300))
    assert excess.take(300 * 60.0, 23.0, [43.0]) > 15.0


@pytest.mark.parametrize(
    ("air", "units", "degf"),
    [(73.4, [23.0], True), (73.4, [22.0, 24.5], True), (73.4, [23.0, 60.0], False), (23.0, [23.4], False),
     (-40.0, [-40.0], False), (60.0, [23.0], False)],
)  # fmt: skip
def test_a_display_in_degf_is_told_from_a_warm_chamber(air, units, degf):
    assert reads_degf(air, units) is degf


def test_once_we_have_moved_a_lagging_unit_is_no_display_in_degf():
    plausible = Plausible(LIMITS, 60.0)
    plausible.take(reading(0.0, 73.4, 73.4), ours_on=False)
    before = plausible.signals(reading(0.0, 73.4, 73.4), [Signal(23.0, 0.0)])
    plausible.take(reading(1.0, 73.4, 73.4), ours_on=True)
    after = plausible.signals(reading(1.0, 73.4, 73.4), [Signal(23.0, 1.0)])
    assert (before["display_degf"].value, after["display_degf"].value) == (1.0, 0.0)
    assert "degC" in before["display_degf"].detail


def test_no_file_takes_one_away():
    standing = [one.guard for one in STANDING]
    mine = GuardSettings(name="air limits", signal="chamber_temperature", above=500.0)
    for groups in [((mine,), ()), ((), (mine,))]:
        with pytest.raises(InputError, match="'air limits' bears the name of one that every run has"):
            guards_of(*groups, (), standing=standing)
    assert guards_of((), (), (), standing=standing)[: len(standing)] == tuple(standing)


@pytest.mark.parametrize("field", ["air_margin_degc", "unit_margin_degc", "setpoint_margin_degc", "unit_lag_min"])
def test_their_margins_have_an_end(field):
    for value in (0, 1e6):
        with pytest.raises(InputError, match=field):
            acquisition.station(protection={field: value})


def test_their_values_are_told():
    text = guards_told(STANDING)
    assert "chamber air above 100 or below -47 degC" in text
    assert "chamber air changes by more than 20 degC/min over 60 s" in text
    assert "unit sensor above 110 degC" in text


def test_a_run_whose_chamber_runs_away_is_ended_and_made_safe(tmp_path, world):
    def overheat(station):
        world[0].shown["temperature"] = 250.0

    result = run_job(acquisition.job(tmp_path, acquisition.LONG), at(20, overheat))
    assert str(result.error).startswith("aborted by guard: air changes too fast: chamber air temperature changes by")
    assert result.run.manifest().state == "aborted"
    assert world[0].chamber.commands().on is False
