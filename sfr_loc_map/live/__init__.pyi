from .config import LiveConfig as LiveConfig
from .hub import Hub as Hub
from .server import LiveServer as LiveServer
from .state import LiveState as LiveState
