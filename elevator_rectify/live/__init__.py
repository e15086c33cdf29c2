"""The live node under load: latency beside a bare relay, a soak, and chaos."""
