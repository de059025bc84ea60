from .chamber import SimulatedChamber as SimulatedChamber
from .outcome import Outcome as Outcome
from .stations import BenchStation as BenchStation
from .table import SimulatedRateTable as SimulatedRateTable
from .unit import SimulatedGyro as SimulatedGyro
