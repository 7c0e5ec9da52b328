"""Hand-eye calibration: A X = X B and A X = Z B, from the classical solvers to the certified robust one.

Enter through ``methods.solve``.
"""
