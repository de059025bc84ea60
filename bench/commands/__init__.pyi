# isort: skip_file
# Measure
from .acquisition import RunOptions as RunOptions
from .acquisition import Task as Task
from .acquisition import check as check
from .acquisition import check_on as check_on
from .acquisition import init as init
from .acquisition import job_of as job_of
from .acquisition import load_station as load_station
from .acquisition import run_profile as run_profile
from .acquisition import sim as sim
from .examination import contract as contract
from .examination import doctor as doctor
from .results.measure import Checked as Checked
from .results.measure import ContractTried as ContractTried
from .results.measure import Copied as Copied
from .results.measure import Examined as Examined
from .results.measure import StationServed as StationServed
from .results.result import Result as Result

# Live runs, on this computer and behind a server
from .live import ENDING_S as ENDING_S
from .live import REACTION_S as REACTION_S
from .live import abort as abort
from .live import act_on_run as act_on_run
from .live import resume as resume
from .live import status as status
from .results.live import REACHED as REACHED
from .results.live import Aborted as Aborted
from .results.live import Asked as Asked
from .results.live import LiveRuns as LiveRuns
from .results.live import Recovered as Recovered
from .server_client import server_abort as server_abort
from .server_client import server_act as server_act
from .server_client import server_at as server_at
from .server_client import server_status as server_status

# Understand
from .analysis import DEFAULT_MODELS as DEFAULT_MODELS
from .analysis import compare as compare
from .analysis import compare_every_sample as compare_every_sample
from .noise_reading import noise as noise
from .analysis import import_table as import_table
from .analysis import recover as recover
from .analysis import report as report
from .comparing import diff as diff
from .comparing import replay_runs as replay_runs
from .diagnosis import add as add
from .diagnosis import diagnose as diagnose
from .diagnosis import effects as effects
from .diagnosis import improve as improve
from .diagnosis import mystery as mystery
from .diagnosis import reveal as reveal
from .diagnosis import show_effect as show_effect
from .results.analyse import WORST_FIRST as WORST_FIRST
from .results.analyse import Compared as Compared
from .results.analyse import ComparedSamples as ComparedSamples
from .results.analyse import Diagnosed as Diagnosed
from .results.analyse import Differs as Differs
from .results.analyse import EffectAdded as EffectAdded
from .results.analyse import Effects as Effects
from .results.analyse import EffectShown as EffectShown
from .results.analyse import Imported as Imported
from .results.analyse import Improved as Improved
from .results.analyse import MysteryMade as MysteryMade
from .results.analyse import NoiseCoefficient as NoiseCoefficient
from .results.analyse import NoiseFound as NoiseFound
from .results.analyse import NotAnalysed as NotAnalysed
from .results.analyse import Replayed as Replayed
from .results.analyse import Reported as Reported
from .results.analyse import Revealed as Revealed
from .results.analyse import UnitReport as UnitReport
from .results.analyse import UnitsReported as UnitsReported

# Deliver
from .calibration.command import calibrate_unit as calibrate_unit
from .calibration.order import Order as Order
from .certifying import CertificateOptions as CertificateOptions
from .certifying import certificate as certificate
from .delivering import export as export
from .flashing import FlashOptions as FlashOptions
from .flashing import flash as flash
from .flashing import verify as verify
from .results.deliver import Calibrated as Calibrated
from .results.deliver import Certified as Certified
from .results.deliver import Exported as Exported
from .results.deliver import Flashed as Flashed
from .results.deliver import Verified as Verified

# Many units
from .fleet import fleet as fleet
from .refitting import RefitOptions as RefitOptions
from .refitting import refit as refit
from .registering import add_equipment as add_equipment
from .registering import register_runs as register_runs
from .registering import registry_equipment as registry_equipment
from .registering import registry_list as registry_list
from .registering import registry_rebuild as registry_rebuild
from .registering import registry_show as registry_show
from .registering import registry_tell as registry_tell
from .results.stock import EquipmentListed as EquipmentListed
from .results.stock import FleetJudged as FleetJudged
from .results.stock import Noted as Noted
from .results.stock import Refitted as Refitted
from .results.stock import RegisteredRuns as RegisteredRuns
from .results.stock import RegistryEntry as RegistryEntry
from .results.stock import RegistryRebuilt as RegistryRebuilt
