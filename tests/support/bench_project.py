"""A project folder for the page's tests: plans of seconds, limits that they can meet, and a station that is slow."""

from contextlib import contextmanager

import httpx

from tests.support.servers import site_over
from tests.support.waiting import until

SHORT = """
name: short
description: Twice from 40 to 10 degC and back, for a few seconds on the simulator.
start: {temperature_degc: 25}
settle: {dwell_min: 1, slope_degc_per_min: 0.5}
rates: {heating_degc_per_min: 3, cooling_degc_per_min: 2}
segments:
  - {kind: ramp, to_degc: 40, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 6}
  - {kind: ramp, to_degc: 10, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 6}
  - {kind: ramp, to_degc: 40, rate_degc_per_min: 3}
  - {kind: ramp, to_degc: 10, rate_degc_per_min: 1.5}
  - {kind: ramp, to_degc: 25, rate_degc_per_min: 2}
"""
HOURS = """
name: hours
description: Its first ramp begins after a minute; then it goes on for hours of bench time.
start: {temperature_degc: 23}
settle: {band_degc: 2, unit_band_degc: 5, slope_degc_per_min: 20, dwell_min: 0.1}
segments:
  - {kind: ramp, to_degc: -30, rate_degc_per_min: 0.5}
  - {kind: ramp, to_degc: 85, rate_degc_per_min: 1}
  - {kind: soak, duration_min: 15}
  - {kind: ramp, to_degc: 25, rate_degc_per_min: 1}
  - {kind: soak, duration_min: 300}
"""
LIMITS = """
name: short
description: What the short plan can tell.
limits:
  - {quantity: residual_rms_dph, unit: deg/h, upper: 0.5, marginal: 0.1, reason: a quarter of the raw bias}
  - {quantity: samples_lost, unit: "1", upper: 0, reason: every sample counts}
"""
BRIEF = """
name: brief
description: From 15 to 35 degC and back, for a few seconds on the simulator.
start: {temperature_degc: 25}
settle: {dwell_min: 1, slope_degc_per_min: 0.5}
segments:
  - {kind: ramp, to_degc: 35, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 18}
  - {kind: ramp, to_degc: 15, rate_degc_per_min: 1.5}
  - {kind: soak, duration_min: 12}
  - {kind: ramp, to_degc: 25, rate_degc_per_min: 1.5}
"""
BRIEF_CHECK = """
name: brief_check
description: The same range at other rates.
start: {temperature_degc: 25}
settle: {dwell_min: 1, slope_degc_per_min: 0.5}
segments:
  - {kind: ramp, to_degc: 17, rate_degc_per_min: 1}
  - {kind: soak, duration_min: 10}
  - {kind: ramp, to_degc: 33, rate_degc_per_min: 1.2}
  - {kind: soak, duration_min: 8}
  - {kind: ramp, to_degc: 25, rate_degc_per_min: 1}
"""
BRIEF_PLAN = """
name: brief
description: The whole way in seconds on the simulator.
profile: ../brief.yaml
verification: ../brief_check.yaml
models: [polynomial]
limits: ../limits/brief.yaml
policy: {marginal: ship, missing_effect: ship, unknown_effect: ship, undecided: ship, tie: ship, undiagnosed: ship}
"""
BRIEF_LIMITS = """
name: brief
description: What the brief calibration can tell.
limits:
  - {quantity: residual_rms_dph, unit: deg/h, upper: 2.0, marginal: 0.1, reason: well below the raw bias}
  - {quantity: samples_lost, unit: "1", upper: 0, reason: every sample counts}
"""
BARE = """
name: bare
simulated: true
seed: 5
ambient_degc: 23
chamber: {map: watlow_f4t, lowest_degc: -42, highest_degc: 95, heating_degc_per_min: 5, cooling_degc_per_min: 3}
buses:
  can0: {interface: blocks, channel: bare}
units:
  - {serial: BARE-1, bus: can0, number: 0, identity: 1}
"""
"""Without laboratory and equipment."""
UNHURRIED = """
name: unhurried
simulated: true
seed: 3
ambient_degc: 23
chamber: {map: watlow_f4t, lowest_degc: -42, highest_degc: 95, heating_degc_per_min: 5, cooling_degc_per_min: 3}
buses:
  can0: {interface: virtual, channel: unhurried}
units:
  - {serial: GX-0007, bus: can0, number: 0, identity: 7}
"""
"""Its frames go over the bus one by one: hours of bench time take minutes, so that there is time to do something."""
LONG, SLOW_UNIT = "hours", "GX-0007"


def made(root):
    """The project folder `root`."""
    files = {
        "short.yaml": SHORT,
        "hours.yaml": HOURS,
        "limits/short.yaml": LIMITS,
        "stations/unhurried.yaml": UNHURRIED,
        "brief.yaml": BRIEF,
        "brief_check.yaml": BRIEF_CHECK,
        "plans/brief.yaml": BRIEF_PLAN,
        "limits/brief.yaml": BRIEF_LIMITS,
        "stations/bare.yaml": BARE,
    }
    for name, text in files.items():
        path = root / "profiles" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


API = "/api/v1"


class Bench:
    """The server and those of its runs that are to be ended after a test."""

    def __init__(self, site, token=None):
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self.site, self.out = site, site.out
        self.client = httpx.Client(base_url=f"{site.address}{API}", headers=headers, timeout=60, trust_env=False)

    def get(self, path):
        return self.client.get(path).raise_for_status().json()

    def start(self, **order):
        """The id of a run that goes on."""
        start = self.client.post("/starts", json=order).raise_for_status().json()["start"]
        return until(lambda: self.get(f"/starts/{start}")["runs"])[0]

    def in_segment(self, run):
        """How the run is, in a segment; None before it, and where it does not answer at once, on a busy computer."""
        answer = self.client.get(f"/live/{run}")
        if answer.status_code == httpx.codes.CONFLICT:
            return None
        now = answer.raise_for_status().json()
        return now if now.get("segment") else None

    def moving(self, run):
        """Wait until the run is in the middle of a ramp."""

        def seen():
            now = self.in_segment(run)
            ramp = now and now["segment"]["kind"] == "ramp"
            return ramp and now["t_s"] > now["segment"]["from_s"] + 30 and now

        return until(seen)

    def end_runs(self):
        """Abort what goes on, and wait until nothing of it is left."""
        for run in self.get("/live")["runs"]:
            self.client.post(f"/live/{run['run']}/abort?wait_s=60", json={})
        until(lambda: all(one["state"] in {"ended", "refused"} for one in self.get("/starts")["starts"]))


@contextmanager
def bench_over(out, project, *options, token=None):
    with site_over(out, *options, project=project) as site:
        bench = Bench(site, token)
        try:
            yield bench
        finally:
            bench.end_runs()
            bench.client.close()
