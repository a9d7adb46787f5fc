"""The program `bms-gateway`: one file per command."""
