from .decorators import is_on_disk as is_on_disk
from .decorators import kernel as kernel
from .decorators import lean as lean
from .decorators import part as part
