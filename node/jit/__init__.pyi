from .compile_events import always_heard_by as always_heard_by
from .compile_events import compiling_heard_by as compiling_heard_by
from .decorators import is_on_disk as is_on_disk
from .decorators import kernel as kernel
from .decorators import lean as lean
from .decorators import part as part
from .switches import SIMD as SIMD
from .switches import why_off as why_off
