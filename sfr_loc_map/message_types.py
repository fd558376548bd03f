"""Names of the ROS 2 message types that the suite reads and writes; levels and kinds of a status on /diagnostics."""

from enum import IntEnum, StrEnum

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
POINT = "geometry_msgs/msg/PointStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
PATH = "nav_msgs/msg/Path"
POINTS = "sensor_msgs/msg/PointCloud2"
GRID = "nav_msgs/msg/OccupancyGrid"
DISPARITY = "stereo_msgs/msg/DisparityImage"
FIX = "sensor_msgs/msg/NavSatFix"
JOINTS = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
TF = "tf2_msgs/msg/TFMessage"
CLOCK = "rosgraph_msgs/msg/Clock"


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3

    @property
    def word(self) -> str:
        """Name of the level in texts and in the JSON of the live page."""
        return "warning" if self is Level.WARN else self.name.lower()


class StatusKind(StrEnum):
    """Kind of a node's status on /diagnostics. The name of the status is `NODE: KIND`."""

    HEALTH = "health"
    CALL = "call"
    INPUT = "input"
    """An input that cannot be used."""
    FAULT = "fault"
    """An unexpected exception in the node."""


class HealthKey(StrEnum):
    """Key of a value in the health of a node; the health also has keys that begin with `DROPPED`."""

    LIFECYCLE = "lifecycle"
    """State of the managed node."""
    ACTIVITY = "activity"
    """What the node does before it can process data; empty afterwards."""
    PERIOD = "period_s"
    """Period of the health status, s."""


COMPILING = "compiling"  #: Activity of a node that compiles its kernels.
DROPPED = "dropped_"  #: Prefix of the keys that count dropped messages; the rest of the key is the cause.
