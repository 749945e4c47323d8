"""`python -m raygrid`: the command line."""

from raygrid.host.cli import main

main()
