from .split import SPLITS as SPLITS
