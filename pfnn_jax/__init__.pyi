from . import control as control
from . import models as models
from . import motion as motion
from . import training as training
from . import viewer as viewer
from . import workflows as workflows
from .errors import InputError as InputError
from .errors import LostProcessError as LostProcessError
from .errors import TrainingError as TrainingError

__version__: str
