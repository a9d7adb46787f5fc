"""What an estimate means: ageing, mismatch."""
