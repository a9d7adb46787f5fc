"""The live shell: the loop, the clock, the signals and systemd around the engine."""
