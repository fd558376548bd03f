"""Command line as a module: `python -m sfr_loc_map`."""

from sfr_loc_map.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
