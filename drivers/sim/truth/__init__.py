"""The truth of a simulated unit: a catalogue of physical mechanisms, one per file, that integrate separate states.

`MECHANISMS` maps the name used in a station's YAML to its class.
"""

from __future__ import annotations

from typing import Annotated, get_args

from pydantic import Field

from drivers.sim.truth.aging import Aging
from drivers.sim.truth.base import Mechanism
from drivers.sim.truth.bias_jump import BiasJump
from drivers.sim.truth.bias_kink import BiasKink
from drivers.sim.truth.bouc_wen import BoucWen
from drivers.sim.truth.compressor import Compressor
from drivers.sim.truth.creep import Creep
from drivers.sim.truth.drive_amplitude import DriveAmplitude
from drivers.sim.truth.earth_rate import EarthRate
from drivers.sim.truth.emi import Emi
from drivers.sim.truth.etalon import Etalon
from drivers.sim.truth.frost import Frost
from drivers.sim.truth.knee import Knee
from drivers.sim.truth.lock_in import LockIn
from drivers.sim.truth.pattern_angle import PatternAngle
from drivers.sim.truth.periodic import Periodic
from drivers.sim.truth.preisach import Preisach
from drivers.sim.truth.quadrature_leakage import QuadratureLeakage
from drivers.sim.truth.rate_squared import RateSquared
from drivers.sim.truth.resonance_frequency import ResonanceFrequency
from drivers.sim.truth.scale_factor_even import ScaleFactorEven
from drivers.sim.truth.scale_factor_nonlinearity import ScaleFactorNonlinearity
from drivers.sim.truth.scale_factor_temperature import ScaleFactorTemperature
from drivers.sim.truth.shupe import Shupe
from drivers.sim.truth.static_bias import StaticBias
from drivers.sim.truth.supply_voltage import SupplyVoltage
from drivers.sim.truth.temperature_rate import TemperatureRate
from drivers.sim.truth.thermal_lag import ThermalLag
from drivers.sim.truth.thermal_network import ThermalNetwork
from drivers.sim.truth.turn_on import TurnOn
from drivers.sim.truth.two_pole_lag import TwoPoleLag
from drivers.sim.truth.unlogged_drift import UnloggedDrift
from drivers.sim.truth.warm_up import WarmUp

_All = (
    Aging
    | BiasJump
    | BiasKink
    | BoucWen
    | Compressor
    | Creep
    | DriveAmplitude
    | EarthRate
    | Emi
    | Etalon
    | Frost
    | Knee
    | LockIn
    | PatternAngle
    | Periodic
    | Preisach
    | QuadratureLeakage
    | RateSquared
    | ResonanceFrequency
    | ScaleFactorEven
    | ScaleFactorNonlinearity
    | ScaleFactorTemperature
    | Shupe
    | StaticBias
    | SupplyVoltage
    | TemperatureRate
    | ThermalLag
    | ThermalNetwork
    | TurnOn
    | TwoPoleLag
    | UnloggedDrift
    | WarmUp
)
ThermalMechanism = ThermalLag | ThermalNetwork | TwoPoleLag
AnyMechanism = Annotated[_All, Field(discriminator="mechanism")]

MECHANISMS: dict[str, type[Mechanism]] = {
    mechanism.model_fields["mechanism"].default: mechanism for mechanism in get_args(_All)
}
