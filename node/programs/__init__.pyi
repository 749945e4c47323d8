from .programs import Compiled as Compiled
from .programs import Program as Program
from .programs import make_program as make_program
from .programs import program_order as program_order
