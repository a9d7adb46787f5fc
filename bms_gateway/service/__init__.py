"""The live service: loop, clock, signals and systemd around the engine."""
