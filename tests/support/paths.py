"""Where things lie: the project's root, its scenes, and the shared scenes beside it (environment RAYGRID_SHARED)."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCENES = ROOT / "scenes"
SHARED = Path(os.environ.get("RAYGRID_SHARED", ROOT.parent / "shared"))
