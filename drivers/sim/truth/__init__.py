"""The truth of a simulated unit: a catalogue of physical mechanisms, one a file, integrated with states of their own.

`MECHANISMS` maps the name used in a station's YAML to its class.
"""

from __future__ import annotations

from typing import Annotated, get_args

from pydantic import Field

from drivers.sim.truth.base import Mechanism
from drivers.sim.truth.quadrature_leakage import QuadratureLeakage
from drivers.sim.truth.static_bias import StaticBias
from drivers.sim.truth.thermal_lag import ThermalLag
from drivers.sim.truth.thermal_network import ThermalNetwork
from drivers.sim.truth.two_pole_lag import TwoPoleLag

_All = QuadratureLeakage | StaticBias | ThermalLag | ThermalNetwork | TwoPoleLag

ThermalMechanism = ThermalLag | ThermalNetwork | TwoPoleLag
AnyMechanism = Annotated[_All, Field(discriminator="mechanism")]

MECHANISMS: dict[str, type[Mechanism]] = {
    mechanism.model_fields["mechanism"].default: mechanism for mechanism in get_args(_All)
}
