"""Names the parts of `node.runtime.profile`, without what that imports."""

PARTS = ("receive", "birth", "decode", "walk", "hit", "shade", "send", "other", "wait")
