"""Makes one processor of the array: packets, links, its cell and the surfaces in it, the ray step, the process around them.

Each package below is a face of its own and lists in its `__init__.pyi` all that other layers may take; nothing is given
twice, so this one gives no names. Where to look, with what is taken most:

    geometry   the world, its cells, what lies in them: `Space` `World` `Cell` `corners` `Kind` `Batch` `SurfaceSet` `Moves`
    protocol   what travels: `PacketKind` `SIZE` `Frame` `TraceCommand` `Prices` `NodeConfig`, and counts: `BORN` `DIED`
    tracing    what a processor does with rays: `add_missed` `UNIT` `Pixels` `Outputs`
    links      how it speaks to its neighbours: `Link` `Channel` `ZmqChannel` `memory_channels` `ControlChannel` `FaultPlan`
    programs   code that is loaded into it: `Program` `make_program` `program_order`
    runtime    the living processor: `Processor` `NodeState` `pack_request` `read_reply`
    timed      the same in machine time: `ServiceClock` `make_service_clock`
    jit        for whoever compiles kernels: `kernel` `lean` `part`

Three modules are for all: `errors` (what is raised on purpose), `remarks` (what is said in passing) and `faces` (how a package
gives what its stub lists). `main` is a node's process, which `emulator.processes` forks.
"""
