"""sfr_loc_map: stereo localisation, terrain mapping and the metrics that prove how good they are."""

__version__ = "0.1.0"
