"""What every process records with: MCAP files that a kill leaves readable, written beside the loops."""
