from bcid.adaptation.on_line import AdaptedCar as AdaptedCar
from bcid.adaptation.on_line import CarUnderWay as CarUnderWay
from bcid.api import Comparison as Comparison
from bcid.api import DiagnosedRecordings as DiagnosedRecordings
from bcid.api import adapt as adapt
from bcid.api import compare as compare
from bcid.api import diagnose as diagnose
from bcid.api import estimate_motion as estimate_motion
from bcid.api import export_code as export_code
from bcid.api import fit as fit
from bcid.api import load as load
from bcid.api import own_effects as own_effects
from bcid.api import predict as predict
from bcid.api import read as read
from bcid.errors import BcidError as BcidError
from bcid.errors import InputRefused as InputRefused
from bcid.errors import UsageError as UsageError
from bcid.prediction.fitted_model import FittedModel as FittedModel
from bcid.prediction.motion import Motion as Motion
from bcid.prediction.prediction import BeyondData as BeyondData
from bcid.prediction.prediction import Prediction as Prediction
from bcid.prediction.start import Moment as Moment
from bcid.prediction.start import State as State
from bcid.vehicle import Vehicle as Vehicle
from bcid.vehicle import read_vehicle as read_vehicle

__version__: str
__all__: list[str]
