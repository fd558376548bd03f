from .result import save_replay as save_replay
from .result import score_replay as score_replay
