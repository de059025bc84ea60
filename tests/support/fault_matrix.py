"""The fault matrix as data: each fault and its outcome. `python -m tests.support.fault_matrix` writes its page.

`tests/acquisition/test_fault_matrix.py` runs every line and asserts the outcome. Most faults are shown by a simulated
station at given times (`faults` of a station file); faults of processes, signals and disks have a procedure of their
own there, named by `how`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.acquisition.station.settings.faults import OF_BUS, OF_CHAMBER, OF_INSTRUMENT, OF_UNIT

PAGE = Path(__file__).parents[2] / "docs" / "faults.md"
UNIT, BUS = "SIM-0001", "can0"
NO_RETRY = {"safe_state": {"retry_min": 0}}
FROZEN = {"guards": [{"name": "frozen sensor", "signal": "frozen_s", "above": 30, "max_age_s": 30}]}


@dataclass(frozen=True)
class Case:
    """One fault and its outcome."""

    group: str
    name: str
    """What happens, in words; the key of the case."""
    state: str
    exit_code: int
    """Of the run itself; the analysis of a run that is done may still end with 1."""
    event: str
    """`kind: pattern` of an event in the run folder; empty: no event."""
    data: str
    """Effect on the data, in words."""
    faults: tuple[Mapping[str, Any], ...] = ()
    """As in a station file; `at_s` is 20 and `on` the chamber where they are left out."""
    losses: Mapping[str, int | str] = field(default_factory=dict)
    """Counts of the manifest that are not 0; `rate`, `slow`, `sampled` (both): number of affected frames."""
    safe: bool | None = True
    """Whether the chamber itself is at ambient and off afterwards; None: nothing was commanded."""
    station: Mapping[str, Any] = field(default_factory=dict)
    how: str = "rehearsal"
    cause: str = ""
    """Pattern in the last message of the bench."""


def wire(name: str, fault: str, **options: Any) -> Case:
    """An answer of the chamber that is corrupted twice: the request is repeated."""
    return Case("Wire of the chamber", f"{name}, two answers", "done", 0, "", "whole",
                ({"fault": fault, "times": 2, **options},))  # fmt: skip


def outage(name: str, fault: str, **options: Any) -> Case:
    """A chamber that cannot be reached for 15 s."""
    return Case("Wire of the chamber", f"{name}, for 15 s", "done", 0, "link: degraded.*silent for 1",
                "frames whole; the readings of the chamber have a gap", ({"fault": fault, "for_s": 15, **options},)
                )  # fmt: skip


def lost(name: str, fault: str, *, reached: bool = False, **options: Any) -> Case:
    """A chamber that stops answering, or whose answers are all wrong although commands reach it (`reached`)."""
    return Case("Wire of the chamber", f"{name}, for good", "failed", 4, "link: chamber lost: silent for 60",
                "frames whole to the end of the run", ({"fault": fault, **options},), safe=reached, station=NO_RETRY,
                cause="SAFE STATE NOT VERIFIED.*switch the chamber off by hand")  # fmt: skip


def on_bus(name: str, fault: str, data: str, losses: Mapping[str, int | str], event: str = "", **options: Any) -> Case:
    """A fault of the frames that does not end the run."""
    return Case("CAN bus", name, "done", 0, event, data, ({"on": BUS, "fault": fault, **options},), losses)


CHAMBER = (
    wire("answer half a tenth of a second late", "delay", seconds=0.05),
    wire("answer after the timeout", "delay", seconds=0.4),
    wire("answer lost", "drop"),
    wire("answer cut in half", "truncate"),
    wire("answer with a flipped bit", "garble"),
    wire("wrong transaction id", "transaction"),
    wire("wrong device id", "device"),
    wire("wrong function code", "function"),
    wire("wrong register count", "count"),
    wire("exception 6, busy", "exception"),
    wire("answer in two pieces", "split"),
    wire("connection closed in the middle of an answer", "close"),
    outage("silence", "silence"),
    outage("all answers garbled", "garble"),
    outage("exception 6, busy", "exception"),
    outage("connection closed in every answer", "close"),
    outage("connections refused", "refuse"),
    lost("silence", "silence"),
    lost("connections refused", "refuse"),
    lost("wrong function code", "function", reached=True),
    lost("wrong device id", "device", reached=True),
    lost("answers cut in half", "truncate", reached=True),
    lost("connection closed in every answer", "close", reached=True),
    Case("Wire of the chamber", "exception 2, illegal address, once", "done", 0, "",
         "whole; asked register by register from then on", ({"fault": "exception", "code": 2, "times": 1},)),
    Case("Wire of the chamber", "exception 2, illegal address, for 5 s", "failed", 4,
         "end: exception 2, illegal address", "whole to the end of the run",
         ({"fault": "exception", "code": 2, "for_s": 5},)),
    Case("Wire of the chamber", "a gateway repeats old answers permanently", "failed", 4, "guard: frozen sensor",
         "frames whole; readings frozen up to the trip of the guard", ({"fault": "stuck"},), safe=True,
         station=FROZEN | NO_RETRY, cause="SAFE STATE NOT VERIFIED"),
    Case("Wire of the chamber", "writes are confirmed and not executed, for good", "failed", 4,
         "end: SAFE STATE NOT VERIFIED.*reads back", "whole to the end of the run", ({"fault": "ignore"},), safe=False,
         station=NO_RETRY, cause="wrote .* reads back .*switch the chamber off by hand"),
    Case("Wire of the chamber", "a degraded chamber answers again, with `on_return: abort`", "failed",
         4, "link: answers again after 15", "frames whole", ({"fault": "silence", "for_s": 15},),
         station={"chamber.link": {"on_return": "abort"}}, cause="on_return: abort"),
    Case("Chamber", "frozen sensor", "aborted", 3, "guard: frozen sensor: time without a changed reading",
         "whole to the trip of the guard", ({"fault": "frozen"},), station=FROZEN),
    Case("Chamber", "sensor break, shown as an impossible temperature", "failed", 4, "end: temperature.*nan",
         "whole to the end of the run", ({"fault": "sensor_break"},)),
    Case("Chamber", "sensor break, reported by the controller", "aborted", 3, "guard: sensor break: yes",
         "whole to the trip of the guard", ({"fault": "sensor_break"},), station={"chamber.map": "watlow_f4"}),
    Case("Chamber", "door open for 20 s", "done", 0, "hold: held at.*door open: yes",
         "whole; held, then the ramp continues as a separate segment", ({"fault": "door", "for_s": 20},),
         station={"chamber.map": "with_door"}),
    Case("Chamber", "alarm", "aborted", 3, "guard: chamber alarm: limit_status: fail",
         "whole to the trip of the guard; the alarm is not cleared", ({"fault": "alarm"},)),
    Case("Chamber", "set point changed at the panel", "aborted", 3, "guard: operator override.*set point is 70 degC",
         "whole to the trip of the guard", ({"fault": "setpoint", "value": 70},)),
    Case("Chamber", "switched off at the panel", "aborted", 3, "guard: operator override.*the chamber has been off",
         "whole to the trip of the guard", ({"fault": "off"},)),
    Case("Chamber", "power cut of the chamber for 20 s", "aborted", 3,
         "link: answers again after.*set ?point is 23 degC, the bench commanded", "whole to the trip of the guard",
         ({"fault": "restart", "for_s": 20},), cause="operator override"),
    Case("Chamber", "controller restarted with other limits", "aborted", 3,
         "link: answers again after.*the bench commanded", "whole to the trip of the guard",
         ({"fault": "restart", "for_s": 20}, {"fault": "limits", "value": 24.2}), cause="operator override"),
    Case("Chamber", "door open and a guard of the station that ends the profile (`action: safe`)", "aborted", 3,
         "guard: door open: yes", "whole, the way back to ambient included", ({"fault": "door"},),
         station={"chamber.map": "with_door", "guards": [{"name": "door open", "signal": "door", "above": 0.5,
                                                          "max_age_s": 30, "action": "safe"}]},
         cause="the chamber is back at ambient"),
    Case("Chamber", "its highest set point is lowered below the target", "failed", 4, "end: illegal value",
         "whole to the end of the run", ({"fault": "limits", "value": 24.2},)),
    Case("Chamber", "too warm before the start", "aborted", 3, "end: not started: too warm",
         "received before the start", safe=None,
         station={"guards": [{"name": "too warm", "signal": "chamber_temperature", "above": -10, "delay_s": 60}]}),
    Case("Chamber", "fahrenheit instead of degC", "refused", 2, "", "no run folder: refused when it is opened",
         safe=None, how="fahrenheit"),
)  # fmt: skip

CAN = (
    on_bus("a tenth of the frames lost, 10 s", "loss", "gaps of exactly the lost frames",
           {"lost": "rate", "slow_lost": "slow"}, share=0.1, for_s=10),
    on_bus("a tenth of the frames twice, 10 s", "duplicate", "whole; each repetition counted",
           {"repeated": "sampled"}, share=0.1, for_s=10),
    on_bus("a bit flipped in a tenth of the frames, 10 s", "corrupt",
           "every wrong CRC found; gaps of exactly these frames; a flipped serial number is ignored",
           {"corrupt": "sampled", "lost": "rate", "slow_lost": "slow"}, share=0.1, for_s=10),
    on_bus("frames out of order, 10 s", "reorder", "whole; put back in their places",
           {"out_of_order": "some"}, share=0.05, for_s=10),
    on_bus("frames held back for 2 s, then a burst", "burst", "those older than 0.5 s are dropped and counted",
           {"late": 750}, seconds=2.0),
    on_bus("silence for 3 s", "silence", "one gap of its length", {"lost": "rate", "slow_lost": "slow"}, for_s=3),
    on_bus("error frames", "error_frames", "whole; error frames counted", {}, "capture: error frames", share=0.05,
           for_s=10),
    on_bus("bus off for 2 s, then back", "bus_off", "whole: the simulated controller kept what was sent", {},
           "link: bus can0 answers again", for_s=2),
    Case("CAN bus", "silence for good", "aborted", 3, "guard: unit silent: age of the newest frame",
         "whole to the silence",
         ({"on": BUS, "fault": "silence"},)),
    Case("CAN bus", "bus off for good", "failed", 4, "link: bus can0 lost: silent for 4", "whole to the failure",
         ({"on": BUS, "fault": "bus_off"},), cause="bus can0 link lost"),
    Case("CAN bus", "one of two buses off, four units", "failed", 4, "link: bus can1 lost",
         "two units whole and done; two to the failure", ({"on": "can1", "fault": "bus_off"},), how="four",
         cause="dropped: bus can1 link lost"),
    Case("CAN bus", "capture process killed", "failed", 4, "link: bus can0 lost", "whole to the kill",
         how="capture_killed", cause="bus can0 is lost: capture process ended"),
)  # fmt: skip

UNITS = (
    Case("Unit", "unit restarts, announced", "done", 0, "unit: started anew, 1 in all",
         "one gap of its length; time continues", ({"on": UNIT, "fault": "reset", "seconds": 1.0},),
         {"lost": "about 500", "slow_lost": "about 100", "resets": 1}),
    Case("Unit", "unit restarts, unannounced", "done", 0, "unit: started anew, 1 in all",
         "one gap of its length; time continues", ({"on": UNIT, "fault": "silent_reset", "seconds": 1.0},),
         {"lost": "about 500", "slow_lost": "about 100", "resets": 1}),
    Case("Unit", "unit silent for good", "aborted", 3, "guard: unit silent: age of the newest frame",
         "whole to the silence",
         ({"on": UNIT, "fault": "silence"},)),
    Case("Unit", "a second unit under the same number", "failed", 4, "unit: two units with this number",
         "the first unit's, until the second sends", ({"on": UNIT, "fault": "twin"},),
         {"corrupt": "some", "repeated": "some"}, cause="SIM-0001"),
    Case("Unit", "another unit in its place", "failed", 4, "end: 77 answers as number 0",
         "to the first heartbeat of the other one", ({"on": UNIT, "fault": "other_unit", "value": 77},),
         {"resets": "some"}),
    Case("Unit", "wrong unit before the start", "failed", 2, "end: 77 answers as number 0", "frames before the start",
         safe=None,
         faults=({"at_s": 0, "on": UNIT, "fault": "other_unit", "value": 77},)),
    Case("Unit", "no unit before the start", "failed", 4, "end: not started: unit SIM-0001: no sound rate frame",
         "none", ({"at_s": 0, "on": UNIT, "fault": "silence"},), safe=None),
    Case("Unit", "one of four stops sending in mid-ramp", "failed", 4,
         "dropped: unit SIM-0002 left the run: no sound rate frame", "three units whole and done; one to its silence",
         ({"on": "SIM-0002", "fault": "silence"},), how="four", cause="dropped: no sound rate frame"),
    Case("Unit", "one of four gets a second one under its number", "failed", 4, "dropped: unit SIM-0002 left the run",
         "three units whole and done; one to the heartbeat of the other", ({"on": "SIM-0002", "fault": "twin"},),
         how="four", cause="dropped: unit SIM-0002"),
    Case("Unit", "one of four restarts every 5 s", "failed", 4, "dropped: sample counter gone wild",
         "three units whole and done; one to its fifth reset",
         tuple({"at_s": 20 + 5 * k, "on": "SIM-0002", "fault": "reset", "seconds": 0.1} for k in range(5)), how="four",
         cause="sample counter gone wild"),
)  # fmt: skip


def wrong(
    name: str,
    how: str,
    event: str,
    data: str = "6 s left out and counted; the record is not complete",
    losses: str = "about 3000",
) -> Case:
    """Data of the unit that are no measurements for 6 s, which the run survives."""
    counted = {"invalid": losses} | ({"slow_lost": "some"} if how == "temperature missing" else {})
    event = f"left_out: {event}"
    return Case("Unit data", f"{name}, for 6 s", "done", 0, event, data, (), counted, how=f"spoiled: {how}")


UNIT_DATA = (
    wrong("fault code in its status", "status 3", "Status = 3: 3000 samples left out, 50.0 to 56.0 s"),
    wrong("not valid by its own word (`RateValid` = 0)", "RateValid 0", "RateValid = 0: 3000 samples"),
    wrong("its own compensation switched on", "CompensationActive 1", "the unit corrects its rate: 3000 samples"),
    wrong("rate at the end of its range", "rate 7FFFFFFF", "rate outside its range: 3000 samples"),
    wrong("rate that repeats bit for bit", "rate frozen", "rate frozen: 3000 samples"),
    wrong("temperature 20 degC higher from one sample to the next", "temperature + 20",
          "temperature moves faster than it can", losses="some"),
    wrong("temperature that repeats bit for bit", "temperature frozen", "temperature frozen", losses="some"),
    wrong("no temperature frames", "temperature missing", "no temperature", losses="some"),
    wrong("heartbeat says that it is stopped", "heartbeat stopped", r"State = 4 .stopped.*samples left out",
          losses="some"),
    wrong("no heartbeat", "heartbeat missing", "no heartbeat: .* samples left out", losses="some"),
    Case("Unit data", "temperature 20 degC higher for good", "aborted", 3,
         "guard: unit not believed: time without a believed unit temperature",
         "left out from the jump on", (), {"invalid": "some"}, how="spoiled: temperature + 20", cause="not believed"),
    Case("Unit data", "temperature 160 degC", "aborted", 3, "guard: unit too hot: unit temperature = 160 degC",
         "left out from the jump on", (), {"invalid": "some"}, how="spoiled: temperature 160", cause="unit too hot"),
    Case("Unit data", "a second unit with the same serial number and the same counter", "failed", 4,
         "unit: two units with this number", "left out from 10 s before it is certain", (),
         {"invalid": "some", "repeated": "some"}, how="spoiled: twin", cause="came twice, with different values"),
)  # fmt: skip

TABLE = (
    Case("Rate table", "fault of the drive", "failed", 4, "end: drive fault 0x8611", "whole to the end of the run",
         how="drive_fault"),
    Case("Rate table", "drive without power, heartbeat lost", "failed", 4, "end: rate table node 5: .*No SDO response",
         "whole to the end of the run", how="drive_cut", station=NO_RETRY,
         cause="press the emergency stop of the rate table"),
)  # fmt: skip

SUPPLY = {
    "name": "supply",
    "timeout_s": 0.2,
    "link": {"degraded_after_s": 2, "lost_after_s": 8},
    "off": {"command": "OUTP OFF", "query": "OUTP?", "value": 0},
    "on": {"command": "OUTP ON", "query": "OUTP?", "value": 1},
    "read": [{"channel": "supply_current", "query": "MEAS:CURR?"}],
}
HYGROMETER = {
    "name": "hygrometer",
    "link": {"degraded_after_s": 2, "lost_after_s": 8},
    "read": [{"channel": "humidity", "modbus": {"address": 3, "type": "int16", "read": 4, "scale": 0.1}}],
}


def instrument(name: str, ends: tuple[str, int], event: str, data: str, fault: Mapping[str, Any], **more: Any) -> Case:
    """A fault of one instrument of the station, the supply unless `device` is another."""
    device, station = more.pop("device", SUPPLY), more.pop("station", NO_RETRY)
    struck = ({"on": device["name"], **fault},)
    return Case("Instruments", name, *ends, event, data, struck, station={"instruments": [device], **station}, **more)


LOAD_OFF = {"guards": [{"name": "load off", "signal": "supply_current", "below": 0.1, "action": "abort"}]}
DAMP = {"guards": [{"name": "damp", "signal": "humidity", "above": 60, "release_below": 55, "action": "hold"}]}
INSTRUMENTS = (
    instrument("silent for 5 s", ("done", 0), "link: instrument supply.*degraded", "whole; its channel has a gap",
               {"fault": "silence", "for_s": 5}, device=SUPPLY | {"timeout_s": 1.0}),  # a busy machine answers later
    instrument("silent for good", ("failed", 4), "link: instrument supply lost: silent for 8",
               "frames whole to the end of the run", {"fault": "silence"},
               cause="SAFE STATE NOT VERIFIED.*supply"),
    instrument("silent behind its Modbus gateway for good", ("failed", 4), "link: instrument hygrometer lost: silent",
               "frames whole to the end of the run", {"fault": "silence"}, device=HYGROMETER),
    instrument("an optional one silent for good", ("done", 0), "link: instrument hygrometer lost: silent",
               "whole; its channel ends", {"fault": "silence"}, device=HYGROMETER | {"optional": True}),
    instrument("switched off at its panel, and a guard on its current", ("aborted", 3),
               "guard: load off: supply current", "whole to the trip of the guard", {"fault": "switched_off"},
               station=LOAD_OFF),
    instrument("humidity of 80 % for 20 s, and a guard that holds", ("done", 0), "hold: held at .*damp: humidity = 80",
               "whole; held, then the ramp continues as a separate segment",
               {"fault": "value", "value": 80, "for_s": 20}, device=HYGROMETER, station=DAMP),
    instrument("shows the same for good", ("done", 0), "rehearsal: hygrometer: frozen begins",
               "whole; its channel is constant", {"fault": "frozen"}, device=HYGROMETER),
    instrument("ignores commands", ("failed", 4), "end: SAFE STATE NOT VERIFIED.*supply", "whole to the end of the run",
               {"fault": "ignore"}, cause="SAFE STATE NOT VERIFIED.*supply"),
)  # fmt: skip

BENCH = (
    Case("Bench", "SIGINT (Ctrl-C)", "aborted", 3, r"end: aborted by operator \(Ctrl-C\)", "whole", how="sigint"),
    Case("Bench", "SIGTERM", "aborted", 3, "end: aborted by SIGTERM", "whole", how="sigterm"),
    Case("Bench", "SIGHUP (closed terminal)", "aborted", 3, "end: aborted by SIGHUP", "whole", how="sighup"),
    Case("Bench", "exception in the code of the bench", "failed", 1, "end: internal error: ZeroDivisionError", "whole",
         how="bug", cause="ZeroDivisionError"),
    Case("Bench", "SIGKILL, simulated", "aborted", -9, "", "whole to the tick before; recovered from the journals",
         safe=None, how="killed", cause="killed; recovered from its journals"),
    Case("Bench", "SIGKILL with equipment moving", "aborted", -9, "safe_state: chamber off",
         "whole to a second before", how="killed_real", cause="made safe by the watchdog"),
    Case("Bench", "SIGSTOP: the bench hangs", "aborted", -9, "watchdog: killed the bench, which hung",
         "whole to a second before", how="hangs", cause="made safe by the watchdog"),
    Case("Bench", "power cut: the journals end at any byte; `bench resume`", "done", 0,
         "gap: without a record", "whole except the torn block; the gap is not filled", how="power_cut"),
    Case("Bench", "disk full for the journals", "failed", 4, "", "whole to the block that did not fit",
         how="disk_full", cause="cannot record"),
    Case("Bench", "disk full for the tables", "failed", 4, "end: end of profile",
         "in the journals; `bench report` makes the tables later", how="tables_full", cause="cannot record"),
    Case("Bench", "run folder removed", "refused", 4, "", "none: the folder is gone", how="removed",
         cause="the run folder .* was removed while the run was under way"),
    Case("Bench", "disk nearly full", "aborted", 3, "guard: disk nearly full", "whole", how="disk_low"),
    Case("Bench", "calendar clock jumps by a day", "done", 0, "", "whole: bench time is monotonic", how="clock_jump"),
)  # fmt: skip

MATRIX = (*CHAMBER, *CAN, *UNITS, *UNIT_DATA, *TABLE, *INSTRUMENTS, *BENCH)

INTRODUCTION = """\
# Faults and their outcomes

This page is generated from `tests/support/fault_matrix.py` by `python -m tests.support.fault_matrix`.
`tests/acquisition/test_fault_matrix.py` runs every line and asserts state, exit code, event, the state of the chamber
(read from the simulated controller itself, without the wire and the driver), and the data: every sample is present or
counted as lost, no time stamp occurs twice, and each recovered block has the right CRC. If a fault affects frames,
the losses are exactly these frames.

Exit codes: 0 the run was completed, 3 aborted by operator or guard, 4 equipment failed, 2 bad input. *safe*: the
chamber itself is at ambient and off; **left*: nothing was commanded, and it was not changed; *not reached*: it
could not be reached, and the bench reported this on stderr; *safe, but not verified*: only its answers were wrong, it
was switched off, and the bench reported this on stderr. An unverified state is never called safe. –: a simulated
chamber ends with its process.

Random attacks beyond these, on wires, files, processes and page, are counted in [what the bench protects against, and
what not](security.md#how-this-is-known).
"""
MEASURED = """\
## Measured

Figures of one computer with two cores, on 2026-11-21; the commands repeat them.

- **A day of random faults** (`python -m benchmarks.soak --hours 24 --seed 3`): 24.0 h of bench time in 5 min; 136
  faults of 23 kinds and, in the pauses, 135 stretches of wrong data of 11 kinds, and the run was completed. 42,769,044
  samples are present, 46,553 counted as lost, 2,500 as late and 404,903 left out: together exactly the 43,223,000 that
  were sent. 24 resets were counted. No time stamp occurs twice. All 136 faults are events. Resident memory grew by
  5.5 kB/h over the second half; 20 open files and 3 threads in the first and in the last quarter, 6 and 1 before and
  after.
- **SIGKILL** (`python -m benchmarks.kills --kills 22 --seed 1`, real processes and time, the capture of the bus
  killed too): 22 kills, 3 to 10 s after the start. From the last sample on disk to the kill 0.06 s in the median,
  0.17 s at worst. 591 blocks recovered with the right CRC, none torn, no sample missing before the last one. The
  watchdog made the chamber safe, verified, 22 times. A power cut may lose the data not yet forced to the disk: one
  second.
"""
REHEARSE = """\
## Rehearse them

A simulated station can show these faults at given times, to rehearse the reaction of the bench:

```yaml
faults:
  - {at_s: 60, fault: silence, for_s: 20}                            # on: chamber by default
  - {at_s: 120, on: can0, fault: loss, share: 0.01, for_s: 30}       # a bus: frames received from it
  - {at_s: 200, on: SIM-0001, fault: reset, seconds: 0.5}            # a unit: frames that it sends
  - {at_s: 300, on: heater supply, fault: switched_off}              # an instrument
```

Every beginning and end is an event of kind `rehearsal`. `share` of the answers or frames, at most `times` of them;
`seconds` of delay, burst or reset; `code` of an exception; `value` if it needs one.
"""


def markdown() -> str:
    """The page."""
    return "\n".join(_lines())


def _lines() -> Iterator[str]:
    yield INTRODUCTION
    states = Counter(case.state for case in MATRIX)
    counts = ", ".join(f"{count} {state}" for state, count in states.most_common())
    yield f"**{len(MATRIX)} faults: {counts}.**\n"
    for group in dict.fromkeys(case.group for case in MATRIX):
        yield f"## {group}\n"
        yield "| fault | run | exit | chamber | event | data |"
        yield "|---|---|---|---|---|---|"
        for case in MATRIX:
            if case.group == group:
                yield _row(case)
        yield ""
    yield MEASURED
    yield REHEARSE
    for title, known in (("the chamber", OF_CHAMBER), ("a bus", OF_BUS), ("a unit", OF_UNIT),
                         ("an instrument", OF_INSTRUMENT)):  # fmt: skip
        yield f"On {title}:\n"
        yield from (f"- `{name}`: {text}" for name, text in known.items())
        yield ""


def _row(case: Case) -> str:
    chamber = {True: "safe", False: "not reached", None: "left"}[case.safe] if case.how != "killed" else "–"
    if case.safe and "NOT VERIFIED" in case.cause:
        chamber = "safe, but not verified: reported"
    kind, _, pattern = case.event.partition(": ")
    text = pattern.replace(".*", " … ").replace("\\", "").replace(" ?", "").replace("|", "\\|")
    event = f"{kind}: {text}" if kind else "–"
    return f"| {case.name} | {case.state} | {case.exit_code} | {chamber} | {event} | {case.data} |"


if __name__ == "__main__":
    PAGE.write_text(markdown(), encoding="utf-8")
