"""`python -m raygrid`: the command line."""

from raygrid.host.cli.entry import main

main()
