from .config import LiveConfig as LiveConfig
from .server import LiveServer as LiveServer
from .state import LiveState as LiveState
