"""From a configuration to a plan: plugins, ports, wiring, sizes; everything that is known before any work."""
