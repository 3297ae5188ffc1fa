"""`python -m bcid`."""

from bcid.cli.app import main

main()
