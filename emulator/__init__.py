"""Makes an array of processors: links them, cuts space, runs them as processes, drives, simulates and explains them.

As of `node`, each package lists in its `__init__.pyi` what other layers may take. Where to look:

    topology    which processors there are, and what a computer can hold: `indices` `parse_shape` `check_fits`
    partition   the planes between cells: `SPLITS`, and `split.split`
    driver      what the host says to an array, in processes or in memory: `Driver` `Progress` `Collected` `NodeSample`
    processes   an array of real processes: `Array`
    simulator   an array in one process and in machine time: `make_model` `trace` `flood`
    analysis    why an array does what it does: `Provenance` `NaiveMachine`
"""
