from .limits import parse_shape as parse_shape
from .limits import read_memory as read_memory
from .socket_directory import LONGEST_PATH as LONGEST_PATH
from .socket_directory import STATES as STATES
from .socket_directory import SocketDirectory as SocketDirectory
from .socket_directory import process_mark as process_mark
from .socket_directory import process_state as process_state
from .topology import indices as indices
