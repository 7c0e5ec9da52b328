"""What configuration is written in, in SI, and how far one Runge-Kutta step reaches."""

BAR = 1e5  # Pa
LITRE = 1e-3  # m³
LITRE_PER_MINUTE = 1e-3 / 60.0  # m³/s
RUNGE_KUTTA_REACH = 2.78  # h |λ| beyond which classical RK4 diverges on a decaying mode
