"""Names of the parts of `node.runtime.profile`, without what it imports."""

PARTS = ("receive", "birth", "decode", "walk", "hit", "shade", "send", "other", "wait")
