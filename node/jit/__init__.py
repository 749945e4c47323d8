"""Compiles kernels: decorators, the cache on disk, vectors of eight. The only package that knows numba's and llvmlite's insides."""
