"""Names of the columns in the tables that the compiled code reads; all SI.

``A_…`` index a row of the actuator table (6, A_COLUMNS), ``C_…`` the circuit vector (C_COLUMNS,) that all
actuators share, ``F_…`` a row of the flow table (6, F_COLUMNS) that every evaluation leaves behind.
"""

# linkage, as linkage.py takes it
A_KIND, A_BASE, A_LEVER, A_ANGLE0, A_LENGTH0 = range(5)
# chambers: areas (m², or m³/rad of a rotary actuator), dead volumes, stroke, leakage across the piston
A_AREA_A, A_AREA_B, A_DEAD_A, A_DEAD_B, A_STROKE, A_LEAKAGE = range(5, 11)
A_STOP_STIFFNESS, A_STOP_DAMPING, A_CUSHION = range(11, 14)
# spool: ω and ζ, slew limits out of the centre and back (1/s)
A_OMEGA, A_ZETA, A_SLEW_OUT, A_SLEW_BACK = range(14, 18)
# what guards a chamber: relief (m³/s/Pa), anti-cavitation (m³/s/√Pa), counterbalance gain (0 without one)
A_RELIEF, A_ANTICAVITATION, A_COUNTERBALANCE = range(18, 21)
# LuGre friction
A_COULOMB, A_STATIC, A_STRIBECK, A_BRISTLE, A_BRISTLE_DAMPING, A_VISCOUS = range(21, 27)
# four metering edges each, in the order of EDGES: orifice gain (m³/s/√Pa), overlap of the full stroke
EDGES = ("supply_a", "return_b", "supply_b", "return_a")
A_GAIN, A_DEADBAND = 27, 31
# flow curve: slope where an edge opens over the mean slope, extending and retracting
A_SLOPE = 35
# chambers to return past the spool (m³/s/Pa)
A_SPOOL_LEAKAGE = 37
A_COLUMNS = 38

# oil: modulus, wall compliance per chamber, air fraction, polytropic exponent
C_MODULUS, C_WALL, C_AIR, C_EXPONENT = range(4)
# temperature: reference, drifts (1/K), cooling rate (1/s), ambient, heat capacity (0: held)
C_REFERENCE, C_VISCOSITY_DRIFT, C_MODULUS_DRIFT, C_COOLING, C_AMBIENT, C_HEAT_CAPACITY = range(4, 10)
# supply: set and return pressure, pump's limit and gain, line volume, dump orifice, 1 while it runs
C_SET, C_RETURN, C_FLOW_LIMIT, C_PUMP_GAIN, C_LINE_VOLUME, C_DUMP, C_RUNNING = range(10, 17)
C_RELIEF, C_REGULARISATION = range(17, 19)
# counterbalance: setting, pilot ratio, pressure from cracking to full opening
C_HOLD, C_PILOT, C_HOLD_RANGE = range(19, 22)
# what the running pump loses as heat (W); what the pressure compensators keep across an edge (0 without)
C_IDLE_LOSS, C_COMPENSATOR = 22, 23
# counterbalance: lag of the opening behind its pilot (s, 0: none)
C_HOLD_LAG = 24
# load-sensing pump: pressure above the highest load (0: constant pressure), lag of the line (s)
C_LS_MARGIN, C_LS_LAG = 25, 26
C_COLUMNS = 27

# net flow into each chamber, flow drawn from the supply, pressure force, friction, position, velocity, stop
F_NET_A, F_NET_B, F_SUPPLY, F_PUSH, F_FRICTION, F_POSITION, F_VELOCITY, F_STOP = range(8)
# the pressure that the supply works against, 0 with the valve shut
F_LOAD = 8
F_COLUMNS = 9
