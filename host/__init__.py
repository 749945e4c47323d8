"""The front end: scenes, pictures, renders, machine time, the service, probes and the command line."""
