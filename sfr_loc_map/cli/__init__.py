"""The command line `sfr`."""
