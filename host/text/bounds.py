"""Bounds of what users may ask for, as plain numbers, so that what reads options and requests is light to import.

Those that the machine has of itself stand where it keeps them, too (`node.protocol`, `node.runtime.probe`, `host.render`,
`host.scene.pose`): tests/host/text/test_bounds.py holds them to be the same.
"""

MAX_SIDE = 65_536  # pixels
MAX_PIXELS = 1 << 28
MAX_SAMPLES = 1 << 32  # of a pixel
MAX_DEPTH = 31
MAX_WEIGHT = 1e30  # below which rays are not born
MAX_BUDGET = (1 << 32) - 1  # packets
MAX_FRAMES = 1_000_000  # of a shot, and of a turntable
MAX_RATE = 100.0  # samples of a node a second
MAX_PRIORITY = 100
MAX_JOB = 1 << 53  # the number of a job
MOST_LISTED = 10_000  # jobs that one request names, or asks for
MOST_OUTPUTS = 16  # of a job
LONGEST_PATH = 4096  # characters
LONGEST_CLIENT = 64  # characters of the name of a client
