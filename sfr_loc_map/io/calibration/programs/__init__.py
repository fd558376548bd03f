"""Readers of calibration files: one module for each program. `shared` has what several of them require."""
