"""Run the command line as ``python -m calib``."""

from calib.cli.main import main

main()
