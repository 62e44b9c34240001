from .config import FewShotConfig as FewShotConfig
from .config import PretrainConfig as PretrainConfig
from .config import TuningConfig as TuningConfig
from .data import Rows as Rows
from .few_shot_learning import few_shot as few_shot
from .loop import TrainState as TrainState
from .pretraining import pretrain as pretrain
from .tuning import tune_generator as tune_generator
