"""Explains what an array does: the ray tree of a sample, one packet at a time, and the deadlock of finite buffers."""
