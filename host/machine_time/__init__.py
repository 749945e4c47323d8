"""Tells machine time: cost models, simulated frames, the scaling law and its report."""
