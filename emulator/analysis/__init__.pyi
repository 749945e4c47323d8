from .deadlock_model import NaiveMachine as NaiveMachine
from .deadlock_model import Outcome as Outcome
from .deadlock_model import Waiting as Waiting
from .deadlock_model import surely_free as surely_free
from .provenance import Provenance as Provenance
from .provenance import Ray as Ray
from .provenance import SampleTree as SampleTree
