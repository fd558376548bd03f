from .localisation_node import LocalisationNode as LocalisationNode
from .mapping_node import MappingNode as MappingNode
from .monitor_node import MonitorNode as MonitorNode
