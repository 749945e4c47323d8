"""Names of the parts of `node.profile`, without what it imports."""

PARTS = ("receive", "birth", "decode", "walk", "hit", "shade", "send", "other", "wait")
