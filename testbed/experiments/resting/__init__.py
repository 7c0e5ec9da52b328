"""How arms come to rest and stay there: time into position, and millimetres moved while parked."""
