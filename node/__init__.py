"""One processor of the array: packets, links, subvolume, surfaces, kernels and the main loop.

Nothing here knows another process than the neighbours behind its own ports; nothing here imports
``raygrid.emulator`` or ``raygrid.host``.
"""
