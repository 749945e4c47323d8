"""`python -m raygrid`: the command line."""

from raygrid.host.entry import main

main()
