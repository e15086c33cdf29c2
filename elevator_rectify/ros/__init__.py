"""Messages to values and back, pairing of the streams, the node: transport around the core, no mathematics."""
