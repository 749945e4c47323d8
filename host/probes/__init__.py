"""Uses the samples of probes: recorded, summed up, for Perfetto and Prometheus."""
