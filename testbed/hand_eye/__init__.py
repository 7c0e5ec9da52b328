"""Hand-eye calibration outside the services: files, experiments of Hua et al. 2024, the command."""
