"""The parameters of the suite: how they are declared, and the YAML files that give their values.

    parameters    a parameter as a field of a frozen dataclass; the dataclass of values by dotted name
    yaml_file     a YAML file as a mapping; parameters with their descriptions as lines of YAML
    nodes         a ROS parameter file as the sections of an `sfr.yaml`, and vice versa
    sections      a file of either kind as a `Configuration`, and the dataclass of a section

`io.source_config` declares the sections that configure how a source is read, finds the file of a source, and overrides
the values of this file with the options of a command.
"""
