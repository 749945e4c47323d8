from .decorators import is_on_disk as is_on_disk
from .decorators import kernel as kernel
from .decorators import lean as lean
from .decorators import part as part
from .trusted_files import why_not_trusted as why_not_trusted
from .trusted_files import why_not_within as why_not_within
