from .admission import Progress as Progress
from .collector import Collected as Collected
from .collector import Samples as Samples
from .driver import BUDGET as BUDGET
from .driver import PATIENCE as PATIENCE
from .driver import Driver as Driver
from .increments import is_held as is_held
from .samples import NodeSample as NodeSample
