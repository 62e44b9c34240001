from .config import PretrainConfig as PretrainConfig
from .data import Rows as Rows
from .few_shot_learning import FewShotConfig as FewShotConfig
from .steps import TrainState as TrainState
from .tuning import TuningConfig as TuningConfig
from .tuning import tune_generator as tune_generator
