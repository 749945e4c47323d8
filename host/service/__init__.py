"""Keeps an array running for several clients: listener, schedule, worker, scribe and what they answer."""
